"""Random keys by the names of their purposes, and that the methods get theirs in no other way."""

import ast
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import deadreckon
from deadreckon.randomness import NUMBERS, generator, key_for, keys, number, sequence

SOURCE = Path(deadreckon.__file__).parent
METHODS = ("agents", "ope", "mbo", "dynamics", "policies", "training", "online", "data", "stats")
KEY = jax.random.key(7)


def data(key):
    return np.asarray(jax.random.key_data(key)).tolist()


# ---- the functions --------------------------------------------------------------------------------------------------------


def test_a_key_depends_on_its_purpose_alone():
    actor, critics = keys(KEY, "actor", "critics")
    assert data(actor) != data(critics)
    assert [data(key) for key in keys(KEY, "critics", "noise", "actor")] == [
        data(critics), data(key_for(KEY, "noise")), data(actor)
    ]  # fmt: skip
    (alone,) = keys(KEY, "actor")
    assert data(alone) == data(key_for(KEY, "actor")) == data(actor)
    assert data(key_for(jax.random.key(8), "actor")) != data(actor)


def test_a_purpose_that_is_named_twice_is_refused():
    with pytest.raises(ValueError, match="purposes of a key must differ"):
        keys(KEY, "actor", "critics", "actor")
    with pytest.raises(ValueError, match="purposes of a key must differ"):
        keys(KEY, "init", "actor")  # both have the number 0


def test_counters_are_folded_into_the_key_of_the_purpose():
    (rows,) = keys(KEY, "rows")
    assert data(key_for(KEY, "rows", 3)) == data(jax.random.fold_in(rows, 3))
    assert data(key_for(KEY, "rows", 3, 1)) == data(jax.random.fold_in(jax.random.fold_in(rows, 3), 1))


def test_keys_are_the_same_in_compiled_and_vectorised_code():
    names = "actor", "noise", "rows"
    plain = [data(key) for key in keys(KEY, *names)]
    assert [data(key) for key in jax.jit(lambda key: keys(key, *names))(KEY)] == plain
    counted = jax.jit(lambda key, t: key_for(key, "noise", t))(KEY, jnp.int32(5))
    assert data(counted) == data(key_for(KEY, "noise", 5))
    many = jax.random.split(KEY, 4)
    stacked = jax.vmap(lambda key: jnp.stack(keys(key, *names)))(many)
    one_by_one = [[data(key) for key in keys(each, *names)] for each in many]
    assert [[data(key) for key in row] for row in stacked] == one_by_one


@pytest.mark.slow
def test_numbers_of_names_do_not_meet_those_that_stay():
    assert all(0 <= n < 8 for n in NUMBERS.values())
    named = {node.value for path in SOURCE.rglob("*.py") for node in purposes(ast.parse(path.read_text()))}
    assert {"actor", "rollouts", "units", "designs"} <= named
    new = named - set(NUMBERS)
    found = [number(name) for name in new]
    assert min(found) >= 8
    assert len(set(found)) == len(new)


def test_streams_that_collected_logs_follow_from_stay():
    """A run's purposes, and SAC's splits, had these keys before they had names; see `NUMBERS`."""
    for i, purpose in enumerate(["init", "rows", "update", "prepare", "initial_states", "act"]):
        assert data(key_for(KEY, purpose)) == data(jax.random.fold_in(KEY, i))
    for pair in (("actor", "critics"), ("target", "actor_loss")):
        assert [data(key) for key in keys(KEY, *pair)] == [data(key) for key in jax.random.split(KEY)]
    np.testing.assert_array_equal(sequence(3, "act").generate_state(4), np.random.SeedSequence([3, 5]).generate_state(4))


def test_generators_follow_from_seed_purpose_and_counters():
    drawn = generator(3, "units").random(4)
    np.testing.assert_array_equal(drawn, generator(3, "units").random(4))
    others = [generator(4, "units"), generator(3, "folds"), generator(3, "units", 1), generator(3, "units", 2)]
    assert len({tuple(each.random(4)) for each in others} | {tuple(drawn)}) == 5


# ---- the methods ----------------------------------------------------------------------------------------------------------


def name_of(call: ast.AST) -> str | None:
    """The last part of what is called."""
    if not isinstance(call, ast.Call):
        return None
    return getattr(call.func, "attr", getattr(call.func, "id", None))


def purposes(tree: ast.AST) -> list[ast.Constant]:
    """Names that are given to the functions of `randomness`."""
    functions = {"keys", "key_for", "sequence", "generator"}
    calls = [node for node in ast.walk(tree) if name_of(node) in functions]
    return [each for call in calls for each in call.args[1:] if isinstance(each, ast.Constant) and isinstance(each.value, str)]


def is_random(call: ast.Call, name: str) -> bool:
    """Whether it is `jax.random.name`."""
    return ast.unparse(call.func) in (f"jax.random.{name}", f"random.{name}", f"jr.{name}")


def constant(node: ast.AST) -> bool:
    """A number, or the name of one, or a sum of these."""
    if isinstance(node, ast.BinOp):
        return constant(node.left) and constant(node.right)
    return isinstance(node, ast.Constant) or ast.unparse(node).rpartition(".")[2].isupper()


def bare(source: str) -> list[str]:
    """Lines in which a number stands for a purpose, or whose key is both split and folded."""
    tree, found = ast.parse(source), []
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        if is_random(call, "fold_in") and constant(call.args[1]):
            found.append(f"{call.lineno}: a number stands for a purpose: {ast.unparse(call)}")
        if name_of(call) in ("default_rng", "SeedSequence") and call.args and isinstance(call.args[0], ast.List):
            found.append(f"{call.lineno}: numbers stand for a purpose: {ast.unparse(call)}")
    for node in ast.walk(tree):
        unpacked = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)
        if unpacked and isinstance(node.value, ast.Call) and is_random(node.value, "split"):
            found.append(f"{node.lineno}: different things get their keys by a split: {ast.unparse(node)}")
        if isinstance(node, ast.FunctionDef):
            calls = [each for each in ast.walk(node) if isinstance(each, ast.Call) and each.args]
            split = {ast.unparse(each.args[0]) for each in calls if is_random(each, "split")}
            folds = [each for each in calls if is_random(each, "fold_in") or name_of(each) in ("keys", "key_for")]
            both = split & {ast.unparse(each.args[0]) for each in folds}
            found += [f"{node.lineno}: {node.name} splits {key} and folds it, too" for key in sorted(both)]
    return found


@pytest.mark.parametrize("package", METHODS)
def test_methods_name_their_purposes(package):
    paths = [path for path in (SOURCE / package).rglob("*.py") if path.parent.name != "problems"]  # judges, not methods
    assert paths
    wrong = [f"{path.relative_to(SOURCE)}:{line}" for path in paths for line in bare(path.read_text())]
    assert not wrong, "\n".join(["see deadreckon/randomness.py", *wrong])


@pytest.mark.parametrize(
    "line",
    [
        "k = jax.random.fold_in(key, 2)", "k = jax.random.fold_in(key, NOISE)", "k = jax.random.fold_in(key, module.NOISE + 1)",
        "a, b = jax.random.split(key)", "rng = np.random.default_rng([seed, 3])",
        "many = jax.random.split(key, 3); k = jax.random.fold_in(key, i)",
        "many = jax.random.split(key, 3); a, b = keys(key, 'a', 'b')",
    ],
)  # fmt: skip
def test_the_check_sees(line):
    assert bare(f"def f(key, i, seed):\n    {line}\n")


def test_the_check_lets_counters_and_equal_things_pass():
    assert not bare("def f(key, i):\n    k = key_for(key, 'rows', i)\n    many = jax.random.split(k, 3)\n")
    assert not bare("def f(key, i):\n    return jax.random.fold_in(key, i), jax.random.fold_in(key, 2 * i)\n")
