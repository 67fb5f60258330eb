"""What accuracy costs: measurements of seconds, always as paired ratios within one run."""
