"""Benchmarks: suites of methods on tasks, their runs, and what the results say."""
