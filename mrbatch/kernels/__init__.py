"""Part of mrbatch: see docs/."""
