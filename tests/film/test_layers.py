"""The registry of layers: channels, what each needs, and that the parts make the whole after storage."""

from __future__ import annotations

import numpy as np
import pytest
from held import holds

from mrbatch.errors import JobError
from mrbatch.film import layers
from mrbatch.stability import file_cases


def estimates(seed: int = 0, height: int = 9, width: int = 11, exponent: float = 2.0):
    return file_cases.random_parts(seed, height, width, exponent)


def test_channel_names_follow_the_contract():
    names = {name: layer.channels for name, layer in layers.LAYERS.items()}
    assert names["composite"] == ("R", "G", "B", "A")
    assert names["virtual"] == ("virtual.R", "virtual.G", "virtual.B", "virtual.A")
    assert names["depth"] == ("depth.Z",) and names["motion"] == ("motion.X", "motion.Y")
    assert names["normal"] == ("normal.X", "normal.Y", "normal.Z")
    assert names["samples"] == ("samples",) and names["shadow"] == ("shadow",)
    assert names["crypto_object"][:4] == tuple(f"CryptoObject00.{c}" for c in "RGBA")
    every = [c for layer in layers.LAYERS.values() for c in layer.channels]
    assert len(every) == len(set(every))
    for layer in layers.LAYERS.values():
        assert set(layer.needs) <= set(layers.ESTIMATES) and layer.meaning


def test_what_is_off_needs_nothing():
    assert layers.needs([]) == {"P", "a", "B", "D"}
    assert layers.needs(["depth"]) == {"P", "a", "B", "D", "depth"}
    assert "D_indirect" in layers.needs(["shadow"]) and "D_indirect" not in layers.needs(None)
    assert "object_ids" not in layers.needs(["crypto_material"])


def test_order_is_the_registrys_whatever_was_asked():
    asked = layers.channels(["delta", "virtual", "delta"], estimates())
    assert list(asked) == list(layers.channels(["virtual", "delta"], estimates()))
    assert list(asked)[:5] == ["R", "G", "B", "A", "virtual.R"]
    assert all(values.dtype == np.float32 for values in asked.values())
    assert not np.any(asked["A"] != 1.0)


def test_unknown_layer_names_its_neighbour():
    with pytest.raises(JobError, match="virtual"):
        layers.choose(["virtaul"])
    with pytest.raises(JobError) as caught:
        layers.choose(["zzz"])
    assert caught.value.exit_code == 2 and "delta" in str(caught.value)


def test_missing_estimates_and_wrong_shapes_are_found():
    with pytest.raises(KeyError, match="depth"):
        layers.channels(["depth"], estimates())
    with pytest.raises(ValueError, match="motion"):
        layers.channels(["motion"], {**estimates(), "motion": np.zeros((9, 11, 3))})
    with pytest.raises(ValueError, match="size"):
        layers.channels(["samples"], {**estimates(), "samples": np.zeros((9, 10))})


def test_empty_values():
    view = layers.empty(["depth", "normal"], 2, 3)
    assert view["depth.Z"].shape == (2, 3) and np.all(view["depth.Z"] == np.float32(1e10))
    assert np.all(view["normal.X"] == 0) and np.all(view["A"] == 1) and np.all(view["R"] == 0)


def test_channel_kinds():
    assert layers.channel_kind("delta.R") == "colour" and layers.channel_kind("R") == "colour"
    assert layers.channel_kind("depth.Z") == "data" and layers.channel_kind("CryptoObject00.R") == "data"
    assert layers.channel_kind("somebody.elses") == "data"


@pytest.mark.case("IO-04")
@pytest.mark.parametrize("seed", range(4))
def test_layers_make_the_composite_after_half_storage(seed):
    holds(file_cases.layers_make_the_whole(seed))
    stored = file_cases.stored_layers(seed)
    P, B, D, C = (file_cases.colour(stored, prefix) for prefix in ("virtual.", "background.", "delta.", ""))
    allowed = 2.0**-10 * (np.abs(P) + np.abs(B) + np.abs(D)) + 5 * 2.0**-25
    # Weighting delta by 1 - a a second time, as a plain `over` of everything would, must be seen.
    twice = np.maximum(0, P + (1 - stored["virtual.A"][..., None]) * (B + D))
    assert np.any(np.abs(twice - C) > allowed)
