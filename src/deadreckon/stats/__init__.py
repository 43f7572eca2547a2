"""Statistics that everything else shares: intervals, the bootstrap, and comparisons of scores, on plain arrays."""
