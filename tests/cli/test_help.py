"""What `--help` says of every option: a whole phrase in standard words that stands alone."""

import ast
import dataclasses
import functools
import importlib
import inspect
import pkgutil
import re
import textwrap

import pytest

from deadreckon import cli
from deadreckon.agents import AGENTS, agent_class
from deadreckon.cli.main import main
from deadreckon.mbo import DESIGNERS, designer
from deadreckon.ope import BehaviorModel
from deadreckon.ope.registry import ESTIMATORS, estimator

MODULES = [importlib.import_module(f"deadreckon.cli.{module.name}") for module in pkgutil.iter_modules(cli.__path__)]
KINDS = {
    **{
        f"{module.__name__.rpartition('.')[2]} {name}": kind
        for module in MODULES for name, kind in vars(module).items()
        if dataclasses.is_dataclass(kind) and isinstance(kind, type) and kind.__module__ == module.__name__
    },
    **{f"agent {name}": agent_class(name) for name in AGENTS},
    **{f"designer {name}": type(designer(name)) for name in DESIGNERS},
    **{f"estimator {name}": type(estimator(name)) for name in ESTIMATORS},
    "behaviour model": BehaviorModel,
}  # fmt: skip
# Words that a phrase on its own does not begin with.
FRAGMENTS = {
    "a", "also", "among", "an", "and", "as", "at", "but", "by", "each", "for", "from", "in", "instead", "it", "its", "no", "of",
    "on", "or", "see", "so", "that", "the", "their", "them", "then", "these", "this", "to", "what", "which", "who", "with",
}  # fmt: skip
NAMES = {"CSV", "Euler", "GPUs", "HTML", "Parquet", "Polyak"}  # with which a phrase may begin; all others begin small


@functools.cache
def texts(kind):
    """The help of every field: the comment behind it, or the string below."""
    found = {}
    for base in reversed(kind.__mro__):
        if not base.__module__.startswith("deadreckon"):
            continue
        source = textwrap.dedent(inspect.getsource(base))
        lines, body = source.splitlines(), ast.parse(source).body[0].body
        for node, below in zip(body, [*body[1:], None]):
            if isinstance(node, ast.AnnAssign):
                comment = re.search(r"  # (?!fmt)(.+)$", lines[node.end_lineno - 1])
                string = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and below.value.value
                found[node.target.id] = comment[1] if comment else string or declared(base, node.target.id)
    return found


def declared(kind, field):
    """The help that is part of a type which several commands share."""
    known = getattr(kind.__annotations__[field], "__metadata__", ())
    return next((each.help for each in known if getattr(each, "help", None)), "")


@pytest.mark.parametrize("name", KINDS)
def test_every_help_is_a_phrase(name):
    kind = KINDS[name]
    for field in dataclasses.fields(kind):
        # No options: what has options of its own, and what the command sets.
        if dataclasses.is_dataclass(field.type) or "name=''" in str(field.type) or "Suppress" in str(field.type):
            continue
        text = texts(kind)[field.name]
        words = re.findall(r"[\w'\"-]+", text)
        assert len(words) >= 3, f"{field.name}: {text!r}"
        assert words[0].lower() not in FRAGMENTS, f"{field.name}: {text!r}"
        assert text[0].islower() or words[0] in NAMES, f"{field.name}: {text!r}"
        assert not text.endswith("."), f"{field.name}: {text!r}"
        assert "\n" not in text, f"{field.name} is broken where its source is: {text!r}"
        assert not re.search(r"\b(rows a batch|a seed|a policy each|a second|redrawn|judge)\b", text), f"{field.name}: {text!r}"


@pytest.mark.slow
@pytest.mark.parametrize(("words", "text"), [
    (["train", "--agent", "iql"], "inverse temperature of the advantage weights"),
    (["train", "--agent", "cql"], "log-sum-exp over actions"),
    (["design", "--method", "forward"], "gradient steps that move the designs"),
    (["ope"], "networks per policy"),
])  # fmt: skip
def test_the_command_line_shows_it(words, text, capsys):
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    shown = " ".join(re.sub(r"[│╭╮╰╯─]", " ", capsys.readouterr().out).split())
    assert text in shown


@pytest.mark.parametrize(
    ("name", "field", "words"),
    [("rlpd", "target_entropy", "minus half"), ("mbpo", "target_entropy", "Table B.1"), ("edac", "critics", "hopper 50)"),
     ("sac_n", "critics", "hopper 500)"), ("bear_is", "target_samples", "mean value"),
     ("bear", "target_samples", "best value")],
)  # fmt: skip
def test_helps_of_inherited_fields_say_what_this_agent_does(name, field, words):
    assert words in texts(agent_class(name))[field]
