"""Where passes run: tiles on threads, ray engines, kernel cache, timing tree, work counters.

Importing this package sets Warp up once: quiet, CPU code without value checks.
"""

import warp as wp

wp.config.quiet = True
wp.config.enable_backward = False
