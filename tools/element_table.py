"""Properties of the elements H to Rn, for the features of the superconductor problem: writes the table that the package ships.

    pip install mendeleev && python tools/element_table.py src/deadreckon/mbo/problems/elements.csv

Needed only to make the table again. An empty field: mendeleev knows no value. Valence is the highest of the main oxidation
states.
"""

import csv
from dataclasses import dataclass
from typing import Annotated

import tyro

COLUMNS = (
    "symbol", "atomic_mass", "first_ionization_energy", "atomic_radius", "density", "electron_affinity", "fusion_heat",
    "thermal_conductivity", "valence",
)  # fmt: skip
LAST = 86  # Rn


@dataclass
class Options:
    """Properties of the elements."""

    out: Annotated[str, tyro.conf.Positional]  # CSV file


def main(options: Options) -> None:
    """Units: u, eV, pm, g/cm3, eV, kJ/mol, W/(m K), number of bonds."""
    from mendeleev import element

    with open(options.out, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(COLUMNS)
        for number in range(1, LAST + 1):
            e = element(number)
            valence = max((abs(state) for state in e.oxistates), default=0)
            values = (e.atomic_weight, e.ionenergies.get(1), e.atomic_radius, e.density, e.electron_affinity, e.fusion_heat)
            row = ["" if value is None else f"{value:.6g}" for value in (*values, e.thermal_conductivity, valence)]
            out.writerow([e.symbol, *row])


if __name__ == "__main__":
    main(tyro.cli(Options))
