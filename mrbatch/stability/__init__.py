"""The hard cases as a product command: registry, runner, and the cases of what several methods share."""
