"""Runs, policies and logs on the Hugging Face Hub: uploads, and downloads that are checked before use.

A repository holds only data: JSON, npz, npy and Parquet, with `deadreckon.json` beside them, which says what it is and names
every file with its SHA-256. Nothing else is downloaded, and nothing is unpickled.
"""

import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict

from deadreckon._version import __version__
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import HEADER, read_folder, write_folder
from deadreckon.data.transfer import sha256_of
from deadreckon.errors import UserError, extra
from deadreckon.files import home, read_json, write_json
from deadreckon.foreign.door import refuse_links
from deadreckon.names import file_part, in_markdown, safe_name, shown
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.runs.folder import TRACKED
from deadreckon.runs.run import Run, load
from deadreckon.temporaries import beside

MANIFEST, POLICY, DATASETS = "deadreckon.json", "policy.npz", "datasets/"
_FORMAT = 1
_MOST = 100_000  # most files
# What a repository of each kind may hold.
_FILES = {
    "policy": re.compile(re.escape(POLICY)),
    "log": re.compile(rf"{re.escape(HEADER)}|[^/\\]+\.npy"),
    "run": re.compile(
        r"(run|status)\.json|episodes\.npz|policies/seed\d+\.npz|(metrics|evaluations)/\d{10}\.parquet|evaluations/trajectories\.npz"
    ),
}  # fmt: skip


def push_to_hub(thing: Dataset | Run | EnvPolicy, repo: str, *, private: bool = True) -> str:
    """Uploads a log, a run or a policy to a repository of the Hugging Face Hub, which is created if it does not exist.

    Of a run, the settings, last policies, metrics, evaluations and the ids of its episodes are uploaded; checkpoints, replay
    and segments of the log are not. Anyone who may read the repository sees all rows of a log, and of a run the names and
    levels of its log's columns.

    Args:
        thing: to upload; a `Run` with all its seeds, or a single policy.
        repo: `user/name`; logs go to a repository for data sets.
        private: whether a new repository is private; an existing one is not changed.

    Returns:
        The name that `from_hub` takes: `user/name`, for a log `datasets/user/name`.

    Raises:
        UserError: `huggingface_hub` is missing, nobody is logged in, or the Hub refuses; in one line.
    """
    kind = "log" if isinstance(thing, Dataset) else "run" if isinstance(thing, Run) else "policy"
    repo = repo.removeprefix(DATASETS)
    with tempfile.TemporaryDirectory(prefix="deadreckon-") as scratch:
        folder = Path(scratch) / "repository"
        if isinstance(thing, Dataset):
            write_folder(thing, folder)
        elif isinstance(thing, Run):
            refuse_links(thing.path, "a run's folder", TRACKED)  # links may lead to files that must not be published
            for path in sorted(thing.path.rglob("*")):
                name = path.relative_to(thing.path).as_posix()
                if path.is_file() and _FILES["run"].fullmatch(name):
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(path, folder / name)
        else:
            store.save(folder / POLICY, thing)
        files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
        listed = {name: {"sha256": sha256_of(path), "bytes": path.stat().st_size} for name, path in files.items()}
        write_json(folder / MANIFEST, {"format": _FORMAT, "kind": kind, "version": __version__, "files": listed})
        (folder / "README.md").write_text(shown(_card(thing, kind, repo), keep="\n"), encoding="utf-8")
        call = _Hub(repo, kind == "log")
        call("create_repo", private=private, exist_ok=True)
        call("upload_folder", folder_path=str(folder), commit_message=f"A {kind} of deadreckon {__version__}")
    return f"{DATASETS}{repo}" if kind == "log" else repo


def from_hub(repo: str, *, revision: str | None = None) -> Dataset | Run | EnvPolicy:
    """Downloads and checks an upload of `push_to_hub`, and returns the log, run or policy.

    It is kept in `hub` in the folder of downloaded logs (`DEADRECKON_HOME`), under its commit. The checksums in
    `deadreckon.json` reveal a file that was damaged or replaced on its own; anyone who may write to the repository can change
    both.

    Args:
        repo: `user/name` of a run or policy, `datasets/user/name` of a log.
        revision: branch, tag or commit; None: the newest commit. A commit in the cache needs no network.

    Raises:
        UserError: there is no such repository, it holds something else, or a file does not match its description in the
            repository.
    """
    name = repo.removeprefix(DATASETS)
    root = home() / "hub" / file_part(repo.replace("/", "--"))
    commit = revision if revision and re.fullmatch("[0-9a-f]{40}", revision) else None
    if commit is None or not (root / commit).exists():
        call = _Hub(name, repo.startswith(DATASETS))
        info = call("repo_info", revision=revision, files_metadata=True)
        commit = safe_name(str(info.sha), f"{repo}: commit")
        if not (root / commit).exists():
            _download(call, {each.rfilename: each.size for each in info.siblings or ()}, commit, root, repo)
    return _loaded(root / commit, repo, commit)


def _download(call: "_Hub", sizes: Mapping[str, int | None], commit: str, root: Path, repo: str) -> None:
    """Fetches the listed files of a commit to `root / commit`, which appears only when all are right."""
    if MANIFEST not in sizes:
        raise UserError(f"{repo} has no {MANIFEST}: it was not uploaded by push_to_hub")
    root.mkdir(parents=True, exist_ok=True)
    with beside(root / commit, folder=True) as scratch:
        aside = scratch / "files"
        call("hf_hub_download", filename=MANIFEST, revision=commit, local_dir=str(aside))
        listed = _checked(read_json(aside / MANIFEST), repo)
        for name, about in listed.items():
            if sizes.get(name) != about["bytes"]:
                raise UserError(f"{repo}: {name} has {sizes.get(name)} bytes there, {MANIFEST} says {about['bytes']}")
        for name, about in listed.items():
            call("hf_hub_download", filename=name, revision=commit, local_dir=str(aside))
            if (found := sha256_of(aside / name)) != about["sha256"]:
                raise UserError(f"{repo}: {name} is damaged or was exchanged: its sha256 is {found}, not {about['sha256']}")
        shutil.rmtree(aside / ".cache", ignore_errors=True)  # files of the client
        try:
            aside.replace(root / commit)
        except OSError:
            if not (root / commit).is_dir():  # else another process was faster
                raise


def _checked(manifest: Any, repo: str) -> dict[str, dict[str, Any]]:
    """The files that a repository lists, if all of them are of its kind.

    Raises:
        UserError: it is of another version, or lists what such a repository does not hold.
    """
    bad = UserError(f"{repo}: {MANIFEST} is not one that push_to_hub writes (format {_FORMAT})")
    if not isinstance(manifest, dict) or manifest.get("format") != _FORMAT or manifest.get("kind") not in _FILES:
        raise bad
    files, allowed = manifest.get("files"), _FILES[manifest["kind"]]
    if not isinstance(files, dict) or not 0 < len(files) <= _MOST:
        raise bad
    for name, about in files.items():
        if not allowed.fullmatch(name):
            raise UserError(f"{repo} lists {name!r}, which a {manifest['kind']} does not have; nothing was downloaded")
        safe_name(Path(name).name, f"{repo}: file")
        right = isinstance(about, dict) and isinstance(about.get("bytes"), int)
        if not right or not re.fullmatch("[0-9a-f]{64}", str(about.get("sha256"))):
            raise bad
    return files


def _loaded(folder: Path, repo: str, commit: str) -> Dataset | Run | EnvPolicy:
    kind = read_json(folder / MANIFEST, _Kind)["kind"]
    if kind == "run":
        return load(folder)
    if kind == "policy":
        return store.load(folder / POLICY)
    log = read_folder(folder)
    extra = {**log.provenance.extra, "hub": repo, "commit": commit}
    return replace(log, provenance=replace(log.provenance, extra=extra))


def _card(thing: Any, kind: str, repo: str) -> str:
    """The repository's README, with the metadata that the Hub reads."""
    what = {"log": "A log", "run": "Policies trained by offline reinforcement learning", "policy": "A policy"}[kind]
    facts = [f"# {repo}", "", f"{what}, uploaded by deadreckon {__version__}."]
    if isinstance(thing, Dataset):
        facts += ["", f"{len(thing):,} rows in {thing.episodes:,} episodes; fingerprint `{thing.fingerprint}`."]
    if isinstance(thing, Run):
        config = in_markdown(thing.config)
        facts += ["", f"Agent {config['agent']['name']} on the log {config['data']['name']}, {config['steps']:,} updates,"]
        facts.append(f"seeds {', '.join(map(str, thing.seeds))}. Whether to deploy it has to be decided on held-out episodes.")
    place = f"{DATASETS}{repo}" if kind == "log" else repo
    use = ["", "```python", "import deadreckon as dr", "", f'found = dr.from_hub("{place}")', "```"]
    head = ["---", "library_name: deadreckon", "tags: [offline-reinforcement-learning, deadreckon]", "---", ""]
    return "\n".join([*head, *facts, *use]) + "\n"


class _Kind(TypedDict):
    """What a repository holds."""

    kind: str


class _Hub:
    """Calls of the Hub's client for one repository, whose errors become one line."""

    def __init__(self, repo: str, dataset: bool):
        try:
            import huggingface_hub  # pyrefly: ignore[missing-import] - an extra
        except ImportError as error:
            raise UserError(f"the Hub is reached by huggingface_hub: {extra('hub')}") from error
        self.client = huggingface_hub.HfApi(library_name="deadreckon")
        self.repo, self.kind = repo, "dataset" if dataset else "model"

    def __call__(self, method: str, **options: Any) -> Any:
        try:
            return getattr(self.client, method)(repo_id=self.repo, repo_type=self.kind, **options)
        except Exception as error:  # its own errors and those of its network library, which has changed twice
            why = " ".join(str(error).split())
            raise UserError(f"Hugging Face Hub, {self.kind} {self.repo}: {type(error).__name__}: {why}") from error
