"""Statistics that everything else shares: intervals, the bootstrap, comparisons of scores. It knows arrays alone."""
