"""Other renderers on the same frames: what they take for the same error."""
