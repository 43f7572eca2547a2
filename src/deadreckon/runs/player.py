"""The policy that a folder or file stands for, for rows of a table: with numpy alone if possible, or else in JAX."""

from pathlib import Path
from typing import Any, NamedTuple

from deadreckon.errors import UserError, reading
from deadreckon.files import read_json
from deadreckon.policies import portable
from deadreckon.policies.file import fitting, numpy_player, read_policy
from deadreckon.policies.table_predict import Predictor
from deadreckon.runs.decision_record import ESTIMATES, file_of, is_same, read_results, records_beside
from deadreckon.runs.folder import Folder, policy_seed
from deadreckon.runs.records import CROSS_FIT, read_status

_CERTAIN = ("Deterministic", "UnboundedDeterministic", "GreedyActions", "ThresholdedPolicy")  # kinds that draw nothing


class Chosen(NamedTuple):
    """A policy to use.

    Attributes:
        file: its path.
        words: a description of the policy, and the number of policies.
        sampled: whether the decision that chose it was about its sampled actions; False if there is no decision.
        owner: folder of its run or cross-fit; None for a single file.
        decision: folder of the decision that chose it; None if there is none.
    """

    file: Path
    words: str
    sampled: bool = False
    owner: Path | None = None
    decision: Path | None = None

    def doubts(self, sampled: bool) -> list[str]:
        """What to say where sampled (or else greedy) actions are to be used, and others were evaluated."""
        folder, judged = (self.decision, self.sampled) if self.decision is not None else self._evaluated()
        if folder is None or judged == sampled or not _draws(read_policy(self.file)[0]["policy"]):
            return []
        used, other = ("sampled", "deterministic (greedy)") if sampled else ("deterministic (greedy)", "sampled")
        return [f"{folder} evaluated {other} actions of this policy, but these are {used} (--sampled {not sampled} changes it)"]

    def _evaluated(self) -> tuple[Path | None, bool]:
        """The folder of a record that holds estimates of this policy, and of which actions: that of the run, the one above, or
        the newest of those beside it."""
        owner = self.owner or _owner(self.file)
        if owner is None:
            return None, False
        for folder in (owner, owner.parent, *records_beside(owner, ESTIMATES)):
            try:
                told = read_results(folder / ESTIMATES)
            except UserError:  # there is none, or one that is damaged or of another version and may be of other policies
                continue
            if told["results"] and any(each.get("digest") and is_same(each, self.file) for each in told["policies"]):
                return folder, not told["estimand"].get("greedy", True)
        return None, False


def chosen(path: Path | str, seed: int | None = None) -> Chosen:
    """The policy that `path` stands for.

    Args:
        path: a policy file; a folder of `ope` or `recommend`, for its policy to deploy, also if that is the run's own folder; a
            run, for its first seed that has not failed; or a cross-fit, for its mixture.
        seed: another seed of a run.

    Raises:
        UserError: it is none of these, has no such policy, or the decision is to deploy none.
    """
    path = Path(path)
    against = ""
    if seed is None and (path / ESTIMATES).exists():
        if not (Folder(path).config.exists() or (path / CROSS_FIT).exists()):
            return _of_decision(path)
        decided, against = _own_decision(path)
        if decided is not None:
            return decided
    if Folder(path).config.exists():
        found = _of_run(Folder(path), seed)
        return found._replace(words=f"{found.words}{against}")
    if seed is not None:
        raise UserError(f"{path} is no run, so it has no seeds; leave it out")
    if (path / CROSS_FIT).exists():
        from deadreckon.runs.crossfit import load_cross_fit

        delivered = load_cross_fit(path).policy_path
        found = _of_run(Folder(delivered), None) if delivered.is_dir() else Chosen(delivered, "the policy of the cross-fit")
        return found._replace(owner=path, words=f"{found.words}{against}")
    if path.is_file() and _is_archive(path):
        return Chosen(path, path.name)
    what = "a folder without a run, a cross-fit or estimates" if path.is_dir() else "no file or folder"
    what = "another file than a policy's" if path.is_file() else what
    raise UserError(f"{path} is {what}; give a run folder, such as runs/mine, or a policy file (.npz)")


def _is_archive(path: Path) -> bool:
    """Whether a file begins like that of a policy; the rest is not checked."""
    with reading(path, "a policy file"), open(path, "rb") as file:
        return file.read(2) in (b"PK", b"")


def _of_run(folder: Folder, seed: int | None) -> Chosen:
    config = folder.read_config()
    told = read_status(folder.status, len(config["seeds"])) if folder.status.exists() else {}
    which = policy_seed(str(folder.path), config["seeds"], told.get("failures") or [None] * len(config["seeds"]), seed)
    if not (file := folder.policy(which)).exists():
        raise UserError(f"{folder.path} is not finished; `deadreckon train ... --out {folder.path} --resume` resumes it")
    others = f", one of {len(config['seeds'])} (--policy-seed)" if len(config["seeds"]) > 1 else ""
    return Chosen(file, f"seed {which} of {folder.path}{others}", owner=folder.path)


def _own_decision(path: Path) -> tuple[Chosen | None, str]:
    """The policy that a decision in a run's own folder chose; None, with a remark for users, if the decision is ignored."""
    if "estimand" not in read_json(path / ESTIMATES, dict):  # of another version
        return None, ""
    results = read_results(path / ESTIMATES)
    if not results["choice"]["deploy"]:
        return None, f"; {path / ESTIMATES} says: do not deploy"
    try:
        return _decided(path, results), ""
    except UserError:  # the file is gone, or has another policy in it
        return None, f"; {path / ESTIMATES} evaluated another policy, from before it was trained further"


def _of_decision(path: Path) -> Chosen:
    """The policy to deploy of a folder that holds only a decision.

    Raises:
        UserError: the decision is to deploy none, or as `_decided`.
    """
    results = read_results(path / ESTIMATES)
    choice = results["choice"]
    if not choice["deploy"]:
        reason = f": {choice['reason']}" if choice["reason"] else ""
        raise UserError(f"{path}: the decision is to deploy none of its policies{reason}; name a run to use one nevertheless")
    return _decided(path, results)


def _decided(path: Path, results: dict[str, Any]) -> Chosen:
    """The policy that a record in the folder `path` says to deploy.

    Raises:
        UserError: its file is missing, or is not the one that was evaluated.
    """
    name = results["choice"]["name"]
    judged = next((each for each in results["policies"] if each["name"] == name), {})
    if (file := file_of(judged, path)) is None:
        raise UserError(f"{path}: the policy to deploy, {name}, is not at {judged.get('file')}; name its run")
    sampled = not (results.get("estimand") or {}).get("greedy", True)
    return Chosen(file, f"{name}, the policy to deploy by {path}", sampled, _owner(file), path)


def _draws(policy: dict[str, Any]) -> bool:
    """Whether sampled actions of a policy differ from its greedy ones, by its tree in a file."""
    inner = policy["inner"]
    parts = portable.parts_of(inner)
    return any(map(_draws, parts)) if parts else inner["kind"] not in _CERTAIN


def _owner(file: Path) -> Path | None:
    """The folder of the run or cross-fit in which a policy's file lies."""
    above = file.absolute().parents[:3]  # the run on all episodes of a cross-fit is a folder within it
    crossed = (folder for folder in above if (folder / CROSS_FIT).exists())
    runs = (folder for folder in above if Folder(folder).config.exists())
    return next(crossed, next(runs, None))


def predictor(file: Path, name: str = "rows") -> Predictor:
    """The policy of a file, with numpy alone if possible, without loading JAX.

    Args:
        file: of a policy.
        name: of the rows that it will be given, for errors.

    Raises:
        UserError: the file is missing, damaged or not a policy file.
    """
    tree, arrays = read_policy(file)
    log = tree.get("meta", {}).get("log") or {}
    if (player := numpy_player(file, tree, arrays)) is None:
        from deadreckon.policies import store
        from deadreckon.policies.loaded import TablePolicy

        return fitting(file, TablePolicy(store.load(file), log, name))
    return fitting(file, Predictor(player, log, name))
