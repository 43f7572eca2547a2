"""Where a method meets a judge: train, evaluate, run folders."""
