"""Which columns of a table the names suggest for which role."""

import re
from collections.abc import Sequence

# By role, the names that libraries and people give to such a column, in lower case.
NAMES = {
    "reward": re.compile(r"rewards?|rew|r"),
    "action": re.compile(r"actions?|act|a"),
    "episode": re.compile(r"episodes?(_?(id|index|no|number))?|eps?_?id|traj(ectory|ectories)?(_?(id|index))?|ep"),
    "time": re.compile(r"time|timestamps?|ts|t|(time_?)?steps?(_?(id|index))?"),
    "terminal": re.compile(r"terminals?|is_terminal|terminate(d|ds)|terminations?"),
    "timeout": re.compile(r"time_?outs?|truncate(d|ds)|truncations?"),
    "propensity": re.compile(
        r"propensit(y|ies)(_scores?)?|p_?scores?|(action_|behaviou?r_|logging_)?prob(s|ability|abilities)?|action_prob"
    ),
    "cost": re.compile(r"costs?"),
    "legal": re.compile(r"((legal|valid|available|allowed|feasible|possible)(_?actions?)?|action_?masks?)"),
    "next_legal": re.compile(r"next_((legal|valid|available|allowed|feasible|possible)(_?actions?)?|action_?masks?)"),
}
OURS = ("observation", "action", "reward")  # or these with numbers behind them
DONE = re.compile(r"dones?|is_done|ended|end_of_episode|is_last|is_first|last_step")  # says that, and not why, an episode ended
IDENTITY = re.compile(
    r"(^|_)(u?u?id|user|customer|patient|session|site)(_?(id|no|nr|num|number))?$"
    r"|(^|_)(account|client|invoice|member|order)_?(no|nr|num|number)$"
)
# How the name of a next observation is made of that of the observation.
_NEXT = (
    (r"^next_(.+)$", r"\1"), (r"^(.+)_next$", r"\1"), (r"^new_(.+)$", r"\1"), (r"^(.+)_prime$", r"\1"), (r"^(.+)'$", r"\1"),
    (r"^obs2_(.+)$", r"obs_\1"), (r"^obs2_(.+)$", r"obs1_\1"), (r"^(obs|observation|state|s)_next_(.+)$", r"\1_\2"),
    (r"^sp_(.+)$", r"s_\1"), (r"^(.+)_(?:t1|t\+1|tp1)$", r"\1_t"), (r"^(.+)_(?:t1|t\+1|tp1)$", r"\1"),
)  # fmt: skip


def like(role: str, name: str) -> bool:
    """Whether a column of that name may have the role."""
    return NAMES[role].fullmatch(name.lower()) is not None


def not_observed(name: str) -> bool:
    """Whether a column has the name of another role than that of an observation; a time is one all the same if no column
    identifies episodes."""
    others = ("terminal", "timeout", "propensity", "cost", "episode", "time", "legal", "next_legal")
    return any(like(role, name) for role in others) or DONE.fullmatch(name.lower()) is not None


def ours(names: Sequence[str]) -> bool:
    """Whether a table has the names of columns that this package writes, so that they need no option."""
    return all(key in names or numbered(names, key) for key in OURS)


def row_numbers(names: Sequence[str]) -> list[str]:
    """Those of `names` that a table library gives to the row numbers that it writes."""
    return [column for column in names if column == "" or re.fullmatch(r"Unnamed: \d+", column)]


def numbered(names: Sequence[str], prefix: str) -> list[str]:
    """Those of `names` called prefix_0, prefix_1, ... in the order of their numbers."""
    found = [column for column in names if re.fullmatch(re.escape(prefix) + r"_\d+", column)]
    return sorted(found, key=lambda column: int(column.rpartition("_")[2]))


def next_flags(names: Sequence[str]) -> dict[str, str]:
    """{name: what} for those of `names` that say of the next row whether it is an end, or its action or reward."""
    stems = {name: stem[1] or stem[2] for name in names if (stem := re.fullmatch(r"next_(.+)|(.+)_next", name.lower()))}
    like_one = lambda stem: any(like(role, stem) for role in ("terminal", "timeout", "reward", "action"))  # noqa: E731
    return {name: stem for name, stem in stems.items() if like_one(stem) or DONE.fullmatch(stem)}


def next_of(names: Sequence[str]) -> dict[str, str]:
    """{next observation: observation} for those of `names` whose name says that they are another's next value."""
    by_lower = {name.lower(): name for name in names}
    pairs: dict[str, str] = {}
    for name in names:
        for pattern, made in _NEXT:
            if re.search(pattern, name, re.IGNORECASE):
                found = by_lower.get(re.sub(pattern, made, name, flags=re.IGNORECASE).lower())
                if found is not None and found != name:
                    pairs[name] = found
                    break
    return pairs


def named(role: str) -> str:
    """A role with its article."""
    words = role.replace("_", " ")
    one = f"{'an' if words[0] in 'aeiou' else 'a'} {words}"
    special = {"reward": "the reward", "propensity": "the propensity", "ignore": "left out", "keep": "a column to keep"}
    return special.get(role, role if role in ("terminal", "timeout") else one)
