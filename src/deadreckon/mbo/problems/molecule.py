"""Molecules: activity against a target, from 1,024 bits for substructures that are there (Gaulton et al. 2012; thesis 6.5)."""

from pathlib import Path

import numpy as np
from pyarrow import csv

from deadreckon.errors import UserError, extra, reading
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem, file_of, hidden, texts_of
from deadreckon.mbo.problems.trees import forest
from deadreckon.mbo.variables import Variable

FILE = "molecule.csv"
SOURCE = "a CSV with a column smiles and one of activities, such as MoleculeACE's CHEMBL234_Ki.csv"
ACTIVITIES = ("y [pEC50/pKi]", "pKi", "pIC50", "pChEMBL Value", "activity", "exp")
BITS, RADIUS = 1024, 2


def fingerprints(smiles: list[str]) -> np.ndarray:
    """(molecules, 1024) Morgan fingerprints of radius 2, 0 or 1.

    Raises:
        UserError: RDKit is not installed, or does not understand a molecule.
    """
    try:
        from rdkit import Chem, RDLogger
        from rdkit.Chem import rdFingerprintGenerator
    except ImportError:
        raise UserError(f"molecule reads molecules with RDKit: {extra('design')}") from None
    RDLogger.DisableLog("rdApp.*")  # pyrefly: ignore[missing-attribute] - of a compiled module
    maker = rdFingerprintGenerator.GetMorganGenerator(radius=RADIUS, fpSize=BITS)
    out = np.zeros((len(smiles), BITS), np.uint8)
    for row, text in enumerate(smiles):
        molecule = Chem.MolFromSmiles(text)
        if molecule is None:
            raise UserError(f"row {row}: {text!r} is no molecule in SMILES")
        out[row] = maker.GetFingerprintAsNumPy(molecule)
    return out


def molecule(*, path: Path | str | None = None, column: str | None = None, shown: float = 50.0) -> Problem:
    """Substructures of molecules, of which the less active part is shown; the oracle is a random forest.

    A design is a fingerprint, and nothing makes sure that a molecule has it.

    Args:
        path: a CSV with a column `smiles`; None: the package's folder of designs. Molecules with equal fingerprints count once,
            with their mean activity.
        column: of the activities, where more is better; None: the first of `ACTIVITIES` that is there.
        shown: percentile of the activities up to which molecules are shown.

    Raises:
        UserError: the file is missing or holds something else, or RDKit or scikit-learn are needed and not installed.
    """
    place = file_of("molecule", path, FILE, SOURCE)
    with reading(place, "CSV"):
        table = csv.read_csv(place)
    wanted = [column] if column else [c for c in ACTIVITIES if c in table.column_names]
    if "smiles" not in table.column_names or not wanted or wanted[0] not in table.column_names:
        raise UserError(f"{place}: columns smiles and {column or 'one of ' + ', '.join(ACTIVITIES)} are needed")
    activity = numbers_of(str(place), table, wanted[0], np.arange(table.num_rows))
    bits, owner = np.unique(fingerprints(texts_of(place, table, "smiles")), axis=0, return_inverse=True)
    y = np.bincount(owner.reshape(-1), activity) / np.bincount(owner.reshape(-1))
    variables = tuple(Variable(f"bit{i}", "categorical", levels=(0, 1)) for i in range(BITS))
    full = Designs(bits, y, variables, "molecule", wanted[0])
    oracle = forest("molecule", bits, y)
    return hidden("molecule", full, oracle, oracle.about, most=shown)
