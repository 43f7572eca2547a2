"""A schema for a table with few or no options: roles from the options and from names.

Each choice that may be wrong is reported in a line, and can be overridden.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import pyarrow as pa

from deadreckon.data import roles
from deadreckon.data.arrow import distinct, flat, is_text, levels_of_whole_numbers
from deadreckon.data.asked import Asked, listed
from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.kinds import asked_kinds, check_column, columns_like, kind_of
from deadreckon.data.legal_columns import find_legal
from deadreckon.data.rest import Rest, rest
from deadreckon.data.schema import ONE, Column, Role, Schema
from deadreckon.errors import UserError

_AHEAD: tuple[Role, ...] = ("action", "reward", "terminal", "timeout", "cost", "propensity")
_LEGAL: tuple[Role, ...] = ("legal", "next_legal")


class Drafted(NamedTuple):
    """A schema, and messages about it.

    Attributes:
        schema: of the table.
        told: one line for each choice that may be wrong.
    """

    schema: Schema
    told: list[str]


def draft(table: pa.Table, asked: Asked, name: str = "frame", needed: bool = True) -> Drafted:
    """A schema for a table.

    Args:
        table: (rows,) of each column.
        asked: which column is what, as far as it is known.
        name: of the table, for errors.
        needed: whether a table without an action or a reward is refused.

    Raises:
        UserError: a given column does not exist or cannot have its role.
    """
    maker = _Maker(table, asked, name)
    maker.asked_for()
    maker.by_name()
    if needed:
        maker.complete()
    return maker.drafted()


class _Maker:
    """Gives roles to columns, first those asked for, then by names; what is left is observed."""

    def __init__(self, table: pa.Table, asked: Asked, name: str):
        self.table, self.asked, self.name = table, asked, name
        self.names = table.column_names
        self.roles: dict[str, tuple[Role, str]] = {}  # and why
        self.of: dict[str, str] = {}  # of next observations, or of columns of legal actions
        self.kept: set[str] = set()  # beside the log, whatever their role
        self.doubts: dict[str, str] = {}
        self.told: list[str] = []
        self.kinds = asked_kinds(asked.kinds, table, name)

    def several(self, given: str | Sequence[str] | None) -> list[str]:
        """The columns of one name or prefix, or of several, each once."""
        prefixes = [given] if isinstance(given, str) else given or ()
        return list(dict.fromkeys(column for prefix in prefixes for column in columns_like(self.table, prefix, self.name)))

    def give(self, columns: Sequence[str], role: Role, why: str = "asked for") -> None:
        """A role for columns; one that is asked for in two is refused."""
        for column in columns:
            before = self.roles.setdefault(column, (role, why))[0]
            if before != role:
                how = "ignore it, or name other observations" if role == "observation" else "one column has one role"
                raise UserError(f"{self.name}: column {column} is {roles.named(before)} and {roles.named(role)}; {how}")

    def doubt(self, column: str, text: str) -> None:
        """What should be checked; told, and noted at the column."""
        self.doubts[column] = text
        self.told.append(f"column {column} {text}")

    def asked_for(self) -> None:
        """Roles that are asked for."""
        asked = self.asked
        ignored = self.several(asked.ignore)
        for role in ONE:
            column = getattr(asked, role)
            if column is not None:
                check_column(self.table, column, self.name)
                self.give([column], role)
        self.give(self.several(asked.action), "action")
        if asked.action is not None and not self.having("action"):
            raise UserError(f"{self.name}: no action column is named")
        self.give(self.several(asked.cost), "cost")
        if asked.observations is not None:
            self.give([column for column in self.several(asked.observations) if column not in ignored], "observation")
        self.kept = set(self.several(asked.keep))
        self.give([column for column in self.several(asked.keep) if column not in self.roles], "keep")
        self.give([column for column in ignored if column not in self.roles], "ignore")

    def following_asked_for(self) -> None:
        """Next observations that are asked for: by their names, or by their places."""
        following = self.several(self.asked.next_observations)
        named = self.asked.observations is not None
        rest = [column for column in self.rest_but(following) if not roles.not_observed(column)]
        have = {*self.having("observation")}
        observed = [column for column in self.several(self.asked.observations) if column in have] if named else rest
        pairs = {c: o for c, o in roles.next_of(self.names).items() if c in following and o in observed}
        if len(pairs) < len(following):
            if len(following) != len(observed):
                text = f"{len(following)} next observations, but {len(observed)} observations ({', '.join(observed[:8])})"
                raise UserError(f"{self.name}: {text}; each observation needs its own")
            pairs = dict(zip(following, observed))
        self.give(following, "next_observation")
        self.of |= pairs

    def rest_but(self, columns: Sequence[str]) -> list[str]:
        """What no role was given to, but for these columns, row numbers and times."""
        out = (*columns, *roles.row_numbers(self.names))
        return [c for c in self.names if c not in self.roles and c not in out and not pa.types.is_temporal(self.table[c].type)]

    def having(self, role: Role) -> list[str]:
        """The columns that have the role, in the order of the table."""
        return [column for column in self.names if self.roles.get(column, ("",))[0] == role]

    def by_name(self) -> None:
        """Roles for what was not asked for."""
        self.needed_by_name()
        self.legal()
        if index := [column for column in roles.row_numbers(self.names) if column not in self.roles]:
            self.give(index, "ignore", "looks like a row number")
            self.told.append(f"column {index[0]!r} looks like a row number and is left out of the observations")
        self.following_asked_for()
        self.ahead_by_name()
        self.ends_by_name()
        theirs = set(self.having("action")) == {*self.names} & {"action", *roles.numbered(self.names, "action")}
        of_ours = theirs and roles.ours(self.names) and LOG_PROBS not in self.names and not self.having("propensity")
        for column in [column for column in self.names if column not in self.roles]:
            if roles.DONE.fullmatch(column.lower()):
                self.give([column], "ignore", "says that an episode ended, not why")
                self.doubt(column, "marks starts of episodes and is left out: --episode names a column that identifies them"
                           if "first" in column.lower() else f"marks ends of episodes and is left out: --terminal {column} "
                           f"where the task itself ended, --timeout {column} where only the recording did")  # fmt: skip
            elif column == "propensity" and of_ours:
                self.give([column], "propensity", "by its name beside names of ours")
                self.told.append("column propensity is read as the probability of the logged action (--propensity)")
            elif roles.like("propensity", column) and "propensity" not in {role for role, _ in self.roles.values()}:
                self.give([column], "ignore", "looks like the probability of the logged action")
                self.doubt(column, f"looks like a probability of the logged action and is left out: --propensity {column}, or "
                           f"--observations to observe it")  # fmt: skip
            elif roles.like("cost", column):
                self.give([column], "cost", "named like a cost")
                self.doubt(column, "looks like a cost, is kept and not observed (--observations to observe it)")
        self.following_by_name()
        if self.asked.observations is not None:
            self.give([c for c in self.names if c not in self.roles], "ignore", "not named among the observations")
            return
        moments = [c for c in self.names if c not in self.roles and pa.types.is_temporal(self.table[c].type)]
        if moments:
            self.give(moments, "ignore", "a date")
            self.told.append(f"timestamps are left out of the observations: {', '.join(moments)} (--time {moments[0]})")
        for column in [column for column in self.names if column not in self.roles]:
            self.observe(column)

    def needed_by_name(self) -> None:
        """Action and reward, where their names leave no doubt."""
        if self.asked.reward is None and len(found := self.of_many("reward")) == 1:
            self.give(found, "reward", "by its name")
            self.told.append(f"column {found[0]} is read as the reward (--reward)")
        if self.asked.action is None:
            prefixes = {re.sub(r"_\d+$", "", column) for column in self.names if column not in self.roles}
            if len(found := self.of_many("action", sorted(each for each in prefixes if roles.like("action", each)))) == 1:
                columns = columns_like(self.table, found[0], self.name)
                self.give(columns, "action", "by its name")
                text = f"column {columns[0]} is" if len(columns) == 1 else f"columns {', '.join(columns)} are"
                self.told.append(f"{text} read as the action (--action)")

    def legal(self) -> None:
        """Columns that say which actions are legal, those asked for or those whose names and values leave no doubt."""
        for role in _LEGAL:
            asked = getattr(self.asked, role)
            free = [c for c in self.names if c not in self.roles]
            found = find_legal(self.name, self.table, role, asked, self.having("action"), free)
            self.give(list(found), role, "by its name" if asked is None else "asked for")
            self.of |= {column: of for column, of in found.items() if of is not None}
            shown = f"column {next(iter(found))} says" if len(found) == 1 else f"{listed(list(found))} say"
            option = role.replace("_", "-")
            self.told += [f"{shown} which actions are legal (--{option})"] if found and asked is None else []

    def of_many(self, role: Role, named: Sequence[str] | None = None) -> list[str]:
        """The column whose name suggests the role. Of several it is the one that is called like the role, or the first one that
        tells the time; the others are left out, because they say the same again. Nothing where that is open. A time of texts
        is taken only if there is no other."""
        found = self.free(role) if named is None else list(named)
        if len(found) < 2:
            return found
        able = [column for column in found if role != "time" or self.orders(column)] or found
        exact = [column for column in able if column.lower() == role] or (able[:1] if role == "time" else [])
        if not exact:
            self.told.append(f"columns {', '.join(found)} are all named like the {role}: --{role} says which one it is")
        for column in found if exact else ():
            if column != exact[0] and column in self.names:
                self.give([column], "ignore", f"named like the {role}, as {exact[0]} is")
                how = f"(--{role} {column}, or --observations to observe it)"
                self.doubt(column, f"is named like the {role}, as {exact[0]} is, and is left out {how}")
        return exact

    def free(self, role: str) -> list[str]:
        """Columns whose names suggest the role and that have none."""
        return [column for column in self.names if column not in self.roles and roles.like(role, column)]

    def ahead_by_name(self) -> None:
        """Actions, rewards and flags of the next row, which nobody knows when an action is chosen."""
        timed = self.asked.episode is not None or bool(self.free("episode"))  # else a time is observed, and has a next one
        known = {column for role in _AHEAD for column in self.having(role)}
        named = {c for c in self.names if c not in self.roles and roles.not_observed(c)}
        named -= set() if timed else {c for c in named if roles.like("time", c)}
        ahead = {c: of for c, of in roles.next_of(self.names).items() if of in known | named | {*self.having("time")}}
        for column, of in (roles.next_flags(self.names) | ahead).items():
            if column not in self.roles:
                self.give([column], "ignore", f"the next row's {of}")
                self.doubt(column, f"looks like the {of} of the next row and is left out (--observations to observe it)")

    def following_by_name(self) -> None:
        """Next observations whose names say whose."""
        if self.having("next_observation"):
            return
        named = self.asked.observations is not None
        observed = self.having("observation") if named else self.rest_but(())
        pairs = {c: o for c, o in roles.next_of(self.names).items() if c not in self.roles and o in observed and o != c}
        pairs = {c: o for c, o in pairs.items() if o not in pairs}
        if not pairs:
            return
        found = ", ".join(list(pairs)[:4]) + (", ..." if len(pairs) > 4 else "")
        paired = {*pairs, *pairs.values()}
        # A time without episodes is an observation, unless it holds dates. Names of other roles that could not be given, such
        # as those of two episodes, are none unless they were asked for: they end in an error.
        times = [] if self.having("episode") else [c for c in observed if roles.like("time", c)]
        times = [c for c in times if self.left(c).role == "observation"]
        lacking = [c for c in observed if c not in paired and (named or c in times or not roles.not_observed(c))]
        if lacking:
            self.give(list(pairs), "ignore", "looks like a next observation")
            shown = ", ".join(lacking[:4])
            how = f"; with --ignore {' '.join(lacking)} they are used" if set(lacking) <= set(times) else ""
            lack = "have" if len(lacking) > 1 else "has"
            self.told.append(f"columns {found} look like next observations and are left out, because {shown} {lack} none{how}")
        else:
            self.give(list(pairs), "next_observation", "by its name")
            self.of |= pairs
            self.told.append(f"columns {found} are read as next observations (--next-observations)")

    def ends_by_name(self) -> None:
        """Flags of ends, episodes and times, where names and values agree."""
        ends: tuple[tuple[Role, str], ...] = (("terminal", "true ends of episodes"), ("timeout", "ends of recordings"))
        for role, what in ends:
            if getattr(self.asked, role) is not None or len(found := self.of_many(role)) != 1:
                continue
            if self.is_flag(found[0]):
                self.give(found, role, "by its name")
                self.told.append(f"column {found[0]} is read as the flag of {what} (--{role})")
            else:
                self.give(found, "ignore", f"named like a flag of {what}, but not truth values")
                self.doubt(found[0], f"is named like a flag of {what}, holds other than 0, 1 or truth values, and is left out")
        if self.asked.episode is None and len(found := self.of_many("episode")) == 1:
            column = found[0]
            if distinct(flat(self.table, column)) < self.table.num_rows:
                self.give(found, "episode", "by its name")
                self.told.append(f"column {column} is read as the name of the episode (--episode)")
            else:
                self.give(found, "ignore", "differs in every row")
                self.doubt(column, "differs in every row and is left out (--episode if each row is an episode)")
        found = self.of_many("time") if self.asked.time is None and self.having("episode") else []
        if len(found) == 1 and self.orders(found[0]):
            self.give(found, "time", "by its name")
            self.told.append(f"column {found[0]} is read as the time within an episode (--time)")

    def orders(self, column: str) -> bool:
        """Whether the rows of an episode can be put in order by a column without being asked to: of numbers or dates."""
        kind = self.table[column].type
        return not is_text(kind) and not pa.types.is_null(kind)

    def is_flag(self, column: str) -> bool:
        """Whether all values are truth values, or 0 and 1."""
        return levels_of_whole_numbers(flat(self.table, column)) in ([0], [1], [0, 1])

    def observe(self, column: str) -> None:
        """The role of a column that is left, and what to say of it."""
        found = self.left(column)
        self.give([column], found.role, found.why)
        if found.doubt:
            self.doubt(column, found.doubt)

    def left(self, column: str) -> Rest:
        """What a column becomes to which no rule gives a role."""
        return rest(column, flat(self.table, column), self.kinds.get(column))

    def complete(self) -> None:
        """Refuses a table without action, reward or observation."""
        if lacking := [role for role in ("action", "reward") if not self.having(role)]:
            how = " ".join(f"--{role} COLUMN" for role in lacking)
            raise UserError(
                f"{self.name}: no column is the {' or the '.join(lacking)} by its name; name the columns: {how} "
                "[--observations COLUMN ...] [--episode, --time, --propensity ...], or let `deadreckon data describe` draft a "
                f"schema ({listed(self.names)})"
            )
        if not self.having("observation"):
            why = next((f" ({line})" for line in self.told if "left out" in line), "")
            raise UserError(f"{self.name}: no column is left to be an observation; name them with observations{why}")

    def drafted(self) -> Drafted:
        """The schema, and what to tell of it."""
        columns = []
        # Dimensions are in the order in which they were asked for.
        asked = [*self.several(self.asked.observations), *self.several(self.asked.action)]
        alone = len(self.having("action")) == 1
        for name in dict.fromkeys([*(name for name in asked if name in self.roles), *self.names]):
            role, why = self.roles[name]
            values = flat(self.table, name, ignored=role == "ignore")
            kind, reason, doubt = kind_of(name, values, role, alone=alone, asked=self.kinds.get(name))
            if doubt:
                self.doubt(name, doubt)
            why, keep = ", ".join(filter(None, (why, reason))), name in self.kept and role != "keep"
            of, doubt = self.of.get(name), self.doubts.get(name, "")
            columns.append(Column(name, role, kind, keep=keep, of=of, reason=why, doubt=doubt))
        kinds = {column.name: column.kind for column in columns}
        columns = [replace(c, kind=kinds[str(c.of)]) if c.role == "next_observation" else c for c in columns]
        return Drafted(Schema(tuple(columns)), self.told)
