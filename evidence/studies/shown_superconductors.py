"""Designs for superconductors where the methods are shown as much as those of the thesis were (section 6.6, Table 6.1).

The thesis's table is of UCI's list, whose colder 80 % reach 73.9 K; 80 % of SuperCon's reach 45 K, and 88 % reach 73.5 K. How
far a search gets depends on where it starts from.
"""

from deadreckon.mbo.problems.superconductor import superconductor
from deadreckon.mbo.protocol import evaluate_designers
from deadreckon.mbo.registry import sized


def designs(case: str, *, seed: int, method: str, **fields: float) -> dict[str, float]:
    """Critical temperatures of 128 designs by gradient boosting without bounds, as in the benchmark of 2020.

    Args:
        case: percentile of the temperatures up to which materials are shown.
        seed: of the method.
        method: name of a designer, which has the sizes of the CPU budget.
        **fields: of the designer.

    Returns:
        best: the greatest, in K.
        median: the median, in K.
        shown: the greatest that the method was shown, in K.
    """
    problem = superconductor("superconductor-boosting", shown=float(case), oracle="boosting", bounded=False)
    [result] = evaluate_designers(problem, [(method, sized(method, problem.name, "cpu", **fields))], seeds=[seed])
    scores = result.scores(0)
    best, median = (float(scores.percentile(q, False)) for q in (100, 50))
    return {"best": best, "median": median, "shown": result.data_best}
