"""Sobol's first two dimensions and Owen's nested scramble, on 32-bit words and without state."""

from __future__ import annotations

import warp as wp


@wp.func
def reverse_bits(v: wp.uint32) -> wp.uint32:
    """The word from its last bit to its first; of an index, Sobol's first dimension."""
    x = ((v >> wp.uint32(1)) & wp.uint32(0x55555555)) | ((v & wp.uint32(0x55555555)) << wp.uint32(1))
    x = ((x >> wp.uint32(2)) & wp.uint32(0x33333333)) | ((x & wp.uint32(0x33333333)) << wp.uint32(2))
    x = ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F)) | ((x & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    x = ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF)) | ((x & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    return (x >> wp.uint32(16)) | (x << wp.uint32(16))


@wp.func
def scramble_reversed(v: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Owen's nested scramble of a word whose bits are reversed."""
    # Laine and Karras' hash with Vegdahl's constants (psychopath.io, 2021): a bit of the result
    # depends on itself and lower bits only, which on reversed words is Owen's nested scramble.
    x = v
    x = x ^ (x * wp.uint32(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> wp.uint32(16)) | wp.uint32(1))
    x = x ^ (x * wp.uint32(0x05526C56))
    return x ^ (x * wp.uint32(0x53A22864))


@wp.func
def second_sobol_reversed(index: wp.uint32) -> wp.uint32:
    """Sobol's second dimension, bits reversed."""
    # Sobol's second generator matrix is Pascal's triangle mod 2; its product with the index in five
    # steps (Ahmed, An Implementation Algorithm of 2D Sobol Sequence, EGSR 2024), bits reversed.
    x = index
    x = x ^ ((x >> wp.uint32(1)) & wp.uint32(0x55555555))
    x = x ^ ((x >> wp.uint32(2)) & wp.uint32(0x33333333))
    x = x ^ ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F))
    x = x ^ ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF))
    return x ^ (x >> wp.uint32(16))


vec8ui = wp.types.vector(length=8, dtype=wp.uint32)

# Owen's scramble of eight words at once: every step waits for the one before, so that one number takes as
# long as all of them. The same steps as `scramble_reversed` and `reverse_bits`.
_LANES_STEPS = """
    x = x ^ (x * 0x3D20ADEAu);
    x = x + seed;
    x = x * ((seed >> 16) | 1u);
    x = x ^ (x * 0x05526C56u);
    x = x ^ (x * 0x53A22864u);
    x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    x = ((x >> 4) & 0x0F0F0F0Fu) | ((x & 0x0F0F0F0Fu) << 4);
    x = ((x >> 8) & 0x00FF00FFu) | ((x & 0x00FF00FFu) << 8);
    x = (x >> 16) | (x << 16);
"""
_LANES_SOURCE = f"""
#if defined(__clang__) && !defined(__CUDACC__)
    typedef unsigned lanes __attribute__((ext_vector_type(8)));
    lanes x, seed;
    for (int k = 0; k < 8; ++k) {{ x[k] = words[k]; seed[k] = seeds[k]; }}
    {_LANES_STEPS}
    wp::vec_t<8, unsigned> result;
    for (int k = 0; k < 8; ++k) result[k] = x[k];
    return result;
#else
    wp::vec_t<8, unsigned> result;
    for (int k = 0; k < 8; ++k) {{
        unsigned x = words[k], seed = seeds[k];
        {_LANES_STEPS}
        result[k] = x;
    }}
    return result;
#endif
"""


@wp.func_native(_LANES_SOURCE)
def scramble_lanes(words: vec8ui, seeds: vec8ui) -> vec8ui:
    """Of each word: `scramble_reversed`, then `reverse_bits`."""
