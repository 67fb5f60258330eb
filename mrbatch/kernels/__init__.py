"""Functions that kernels are made of. This is the lowest room that uses Warp, so Warp is set up here:
errors only (a machine without CUDA is no news), and no code for derivatives."""

import warp as wp

wp.config.log_level = wp.LOG_ERROR
wp.config.enable_backward = False
