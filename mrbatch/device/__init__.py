"""Where passes run: tiles on threads, ray engines, kernel cache, timing tree, work counters."""
