"""HTML and SVG as nested calls: whatever is not markup already is escaped, so that no name in a run can break a page."""

import html
from typing import Any

from deadreckon.names import shown


class Markup(str):
    """Text that is markup; every other string is escaped when it becomes part of an element."""

    __slots__ = ()


_VOID = {"br", "hr", "img", "input", "meta", "wbr"}


def _text(child: Any) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, (list, tuple)):
        return "".join(map(_text, child))
    return _escaped(child)


def _escaped(value: Any) -> str:
    return html.escape(shown(value, keep="\n\t"))


def tag(name: str, *children: Any, **attributes: Any) -> Markup:
    """An element; in attribute names `_` stands for `-`, a trailing one is dropped, and None leaves the attribute out."""
    given = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items() if value is not None}
    written = "".join(f' {key}="{_escaped(value)}"' for key, value in given.items())
    if name in _VOID:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{_text(children)}</{name}>")


def join(*children: Any) -> Markup:
    """Elements one after another."""
    return Markup(_text(children))
