"""Making logs again by oneself: recipes that need no server."""

from deadreckon.collect import domains as _domains  # noqa: F401 - recipes register themselves
from deadreckon.collect.in_task import collect_in_task
from deadreckon.collect.recipes import Recipe, collect, generate, recipe, recipe_names, register

__all__ = ["Recipe", "collect", "collect_in_task", "generate", "recipe", "recipe_names", "register"]
