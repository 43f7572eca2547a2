"""For the API pages: the comment behind a field is its description, as it is its help on the command line."""

import ast
import re

import griffe


class FieldComments(griffe.Extension):
    """Gives annotated class fields without a docstring the comment at the end of their line."""

    def on_attribute_instance(self, *, node, attr: griffe.Attribute, agent, **_) -> None:
        """Called by griffe for every attribute that it finds."""
        if attr.docstring or not isinstance(node, ast.AnnAssign) or not attr.lineno or not attr.lines:
            return
        if comment := re.search(r"\s#\s+(.+)$", attr.lines[-1]):
            attr.docstring = griffe.Docstring(comment[1], lineno=attr.lineno, endlineno=attr.endlineno, parent=attr)
