"""Experiment trackers that show runs: TensorBoard, Weights & Biases, MLflow, or your own."""

from deadreckon.runs.trackers.tracker import TRACKERS, Tracker

__all__ = ["TRACKERS", "Tracker"]
