"""GFP: proteins of 237 amino acids that glow (Sarkisyan et al. 2016; thesis 6.5), scored by a learned oracle.

The oracle is a model of global epistasis (Otwinowski et al. 2018): every substitution moves a few hidden traits by fixed
amounts, and the brightness is a nonlinear function of the traits. Substitutions that nobody has measured move nothing.
"""

import re
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from pyarrow import csv

from deadreckon.errors import UserError, reading, unknown
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.oracle import Arrays, kept, split
from deadreckon.mbo.problems.problem import Problem, file_of, hidden, texts_of
from deadreckon.mbo.problems.sequence_gp import SequenceGP
from deadreckon.mbo.variables import Variable
from deadreckon.nets.mlp import MLP, ensemble
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.ope.metrics import rank_correlation

FILE = "avgfp.tsv"
SOURCE = "variants of the wild type and their log10 brightness, a TSV with columns variant and score, as in nn4dms"
ACIDS = "ACDEFGHIKLMNPQRSTVWY"
WILD_TYPE = (
    "SKGEELFTGVVPILVELDGDVNGHKFSVSGEGEGDATYGKLTLKFICTTGKLPVPWPTLVTTLSYGVQCFSRYPDHMKQHDFFKSAMPEGYVQERTIFFKDDGNYKTRAEVKFEGDTLVNRIE"
    "LKGIDFKEDGNILGHKLEYNYNSHNVYIMADKQKNGIKVNFKIRHNIEDGSVQLADHYQQNTPIGDGPVLLPDNHYLSTQSALSKDPNEKRDHMVLLEFVTAAGITHGMDELYK"
)
_WILD = np.array([ACIDS.index(letter) for letter in WILD_TYPE])
_MUTATION = re.compile(r"([A-Z])(\d+)([A-Z*])$")
ORACLES = ("epistasis", "gp")
TRAITS, HIDDEN, MEMBERS = 4, (32,), 3
STEPS, BATCH, LR = 10_000, 512, 3e-3


def gfp(
    name: str = "gfp",
    *,
    path: Path | str | None = None,
    least: float = 50.0,
    most: float = 60.0,
    limit: int | None = 5000,
    oracle: Literal["epistasis", "gp"] = "epistasis",
) -> Problem:
    """Proteins of middling brightness; scored by a learned oracle.

    The benchmark of 2020, which the thesis's tables are of, had a Gaussian process (`gfp-gp` among the problems).

    Args:
        name: of the problem.
        path: the TSV; None: the package's folder of designs. Variants with a stop codon are left out.
        least: percentile of the brightness above which proteins are shown.
        most: percentile up to which they are.
        limit: proteins shown at most.
        oracle: `epistasis` or `gp`, a Gaussian process.

    Raises:
        UserError: the file is missing or holds something else.
    """
    if oracle not in ORACLES:
        raise unknown("oracle", oracle, ORACLES)
    place = file_of("gfp", path, FILE, SOURCE)
    with reading(place, "TSV"):
        table = csv.read_csv(place, parse_options=csv.ParseOptions(delimiter="\t"))
    if not {"variant", "score"} <= set(table.column_names):
        raise UserError(f"{place}: columns variant and score are needed, separated by tabs")
    x, rows = _sequences(texts_of(place, table, "variant"), place)
    y = numbers_of(str(place), table, "score", rows)
    variables = tuple(Variable(f"acid{i}", "categorical", levels=tuple(ACIDS)) for i in range(len(WILD_TYPE)))
    full = Designs(x, y, variables, "gfp", "log10 brightness")
    judge = Epistasis.of(x, y) if oracle == "epistasis" else SequenceGP.of("gfp", x, y)
    return hidden(name, full, judge, judge.about, least=least, most=most, limit=limit)


def _sequences(variants: list[str], place: Path) -> tuple[np.ndarray, np.ndarray]:
    """Codes (n, 237) of the variants without a stop codon, and their rows."""
    out, rows = [], []
    for row, variant in enumerate(variants):
        codes = _WILD.copy()
        for text in filter(None, variant.split(",")):
            found = _MUTATION.match(text)
            at = int(found[2]) if found else -1
            if found is None or at >= len(WILD_TYPE) or WILD_TYPE[at] != found[1]:
                raise UserError(f"{place}: row {row} has {text!r}, no mutation of the wild type counted from 0, such as A108D")
            codes[at] = ACIDS.find(found[3])
        if codes.min() >= 0:  # -1: a stop codon
            out.append(codes)
            rows.append(row)
    if not rows:
        raise UserError(f"{place}: no row has a variant without a stop codon")
    return np.array(out, np.int8), np.array(rows, int)


class Traits(eqx.Module):
    """Brightness of sequences.

    Attributes:
        effect: (sites, acids, traits) what each substitution adds to the traits.
        net: from traits to the standardised brightness.
    """

    effect: Float[Array, "s a t"]
    net: MLP

    @classmethod
    def create(cls, key: Array) -> "Traits":
        """No effects at first, which those of unseen substitutions stay."""
        net = MLP.create(TRAITS, HIDDEN, 1, key, activation="tanh")
        return cls(jnp.zeros((len(WILD_TYPE), len(ACIDS), TRAITS)), net)

    def __call__(self, codes: Int[Array, "b s"]) -> Float[Array, "b"]:
        """(b,) of sequences (b, sites)."""
        wild = jnp.asarray(_WILD)
        moved = self.effect[jnp.arange(len(WILD_TYPE)), codes] * (codes != wild)[..., None]
        return self.net(moved.sum(-2))[..., 0]


class Epistasis(NamedTuple):
    """The learned oracle: the mean of three models."""

    models: Traits
    mean: float
    std: float
    rank_correlation: float
    held_out: int

    @property
    def about(self) -> str:
        """How true it is, in a line."""
        correlation = f"rank correlation {self.rank_correlation:.2f} on {self.held_out:,} held-out proteins"
        return f"{MEMBERS} models of global epistasis; {correlation}"

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(n, sites) designs -> (n,) brightness."""
        blocks = np.array_split(np.asarray(x, np.int32), max(1, len(x) // 2048))
        found = [np.asarray(_predict(self.models, jnp.asarray(block))) for block in blocks]
        return self.mean + self.std * np.concatenate(found)

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray) -> "Epistasis":
        """Trained where it is not known yet; a tenth of the rows, always the same, is held out."""
        like = ensemble(Traits.create, MEMBERS, jax.random.key(0))

        def train() -> Arrays:
            out, rest = split(len(y))
            mean, std = float(y[rest].mean()), float(y[rest].std())
            models = _fit(like, jnp.asarray(x[rest]), jnp.asarray((y[rest] - mean) / std, jnp.float32))
            correlation = rank_correlation(cls(models, mean, std, 0.0, len(out))(x[out]), y[out])
            arrays = {str(i): np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(models))}
            return arrays, {"mean": mean, "std": std, "rank_correlation": correlation, "held_out": len(out)}

        arrays, known = kept("gfp", x, y, (TRAITS, HIDDEN, MEMBERS, STEPS, BATCH, LR), train)
        leaves = [jnp.asarray(arrays[str(i)]) for i in range(len(arrays))]
        return cls(jax.tree.unflatten(jax.tree.structure(like), leaves), **known)


@eqx.filter_jit
def _predict(models: Traits, codes: Array) -> Float[Array, "b"]:
    return jax.vmap(lambda model: model(codes))(models).mean(0)


@jax.jit
def _fit(models: Traits, codes: Array, y: Array) -> Traits:
    """Adam on the squared error, its rate falling to zero along a cosine."""

    def update(carry, step):
        models, opt = carry
        key = jax.random.fold_in(jax.random.key(1), step)
        rows = jax.random.randint(key, (MEMBERS, BATCH), 0, len(y))
        error = lambda model, rows: jnp.square(model(codes[rows].astype(jnp.int32)) - y[rows]).mean()  # noqa: E731
        grads = jax.grad(lambda models: jax.vmap(error)(models, rows).sum())(models)
        lr = LR * (1 + jnp.cos(jnp.pi * step / STEPS)) / 2
        return apply_gradients(models, grads, opt, lr), None

    return jax.lax.scan(update, (models, init_opt(models)), jnp.arange(STEPS))[0][0]
