"""What D4RL's kitchen observations hold: postures of the arm and the kitchen (30 numbers), and the postures that are wanted."""

from collections.abc import Sequence

JOINTS = 30  # numbers of a posture: the arm's 9, and the kitchen's (the kettle has 7)
# A sub-task: where its joints stand in a posture, and what they should be.
ELEMENTS: dict[str, tuple[slice, tuple[float, ...]]] = {
    "bottom burner": (slice(11, 13), (-0.88, -0.01)),
    "top burner": (slice(15, 17), (-0.92, -0.01)),
    "light switch": (slice(17, 19), (-0.69, -0.05)),
    "slide cabinet": (slice(19, 20), (0.37,)),
    "hinge cabinet": (slice(20, 22), (0.0, 1.45)),
    "microwave": (slice(22, 23), (-0.75,)),
    "kettle": (slice(23, 30), (-0.23, 0.75, 1.62, 0.99, 0.0, 0.0, -0.06)),
}
_COMPLETE = ("microwave", "kettle", "light switch", "slide cabinet")
# What is to be done in each task. Complete and partial are the same environment, with different logs.
KITCHENS = {
    "kitchen-complete": _COMPLETE,
    "kitchen-partial": _COMPLETE,
    "kitchen-mixed": ("microwave", "kettle", "bottom burner", "light switch"),
}


def kitchen_goal(elements: Sequence[str]) -> tuple[float, ...]:
    """The posture's 30 numbers that some sub-tasks want, zeros elsewhere."""
    goal = [0.0] * JOINTS
    for where, wanted in (ELEMENTS[name] for name in elements):
        goal[where] = wanted
    return tuple(goal)
