"""Names as an attacker would give them, and a place with much beside it that must stay as it is."""

import contextlib
import hashlib
import json
import os
import unicodedata
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from deadreckon.errors import UserError

ABSOLUTE = "ABSOLUTE"  # stands for the path of a file that is there
NAMES = [
    # other folders, on any system
    "../victim/important", "../../victim/important", "../../../victim/important", ABSOLUTE, "x/../../../RUN", "a/b", "a/", "/",
    "a//b", "./../../RUN", "..\\..\\RUN", "C:\\RUN", "C:RUN", "\\\\server\\share", "..", ".", "", "...", "~", "~root/x", "file:///RUN",
    # what steers terminals, or is read as something else
    "\x1b[2J\x1b[31mDEPLOY", "\x1b]0;owned\x07", "\x9b31mred", "a\rb", "two\nlines", "tab\tbed", "\b\b\bgone", "\u202egpj.exe",
    "\u2066x", "line\u2028apart", "zero\0byte", "\ud800", "\x7f",
    # names that some system keeps, changes or cannot take
    "CON", "nul", "aux.txt", "com1", "LPT¹.log", "PRN .x", "dot.", "blank ", "x" * 300, "é" * 150, "語" * 100, ".hidden",
    # what shells, pages, spreadsheets and patterns make of them
    "-rf", "$(touch RUN)", "`touch RUN`", "; touch RUN", "| touch RUN", "%2e%2e%2fRUN", "*", "?", "[ab]*", "{a,b}", "${HOME}",
    "<script>alert(1)</script>", "\"><img src=x onerror=alert(1)>", "=cmd|' /C calc'!A0", "@SUM(1+1)", "'; DROP TABLE x; --",
]  # fmt: skip
FEW = ["../../victim/important", ABSOLUTE, "x/../../../RUN", "\x1b[2J\x1b[31mDEPLOY", "x" * 300]  # for writers that take long
PLAIN = "plain"  # which no writer may refuse: else the others are refused for what has nothing to do with names


def told(name: str) -> str:
    """A name as the id of a test."""
    plain = name.encode("unicode_escape").decode().replace("[", "(").replace("]", ")")
    return plain if len(plain) < 30 else f"{plain[:20]}({len(name)})"


class Place:
    """A folder to work in, deep among files that must stay.

    Attributes:
        work: where everything belongs that is written.
    """

    def __init__(self, root: Path):
        self.root, self.work = root, root / "one" / "two" / "work"
        self.work.mkdir(parents=True)
        for folder in (root, root / "one", root / "one" / "two", self.work / "home", self.work):
            (folder / "victim").mkdir(parents=True)
            for name in ("important", "important.npy", "important.json", "important.csv", "important.html", "important.hdf5"):
                (folder / "victim" / name).write_text("mine")
        self.before = self._files()

    def name(self, name: str) -> str:
        """The name itself, an absolute path where it stands for one."""
        return str(self.root / "victim" / "important") if name == ABSOLUTE else name

    def _files(self) -> dict[str, bytes | None]:
        return {
            str(path): path.read_bytes() if path.is_file() else None
            for path in self.root.rglob("*")
            if not path.is_relative_to(self.work) or "victim" in path.relative_to(self.work).parts
        }

    def written(self) -> list[str]:
        """Files that have come."""
        files = (path for path in self.work.rglob("*") if path.is_file())
        return [str(path.relative_to(self.work)) for path in files if str(path) not in self.before]

    def check(self) -> None:
        """Nothing beside the folder has come, gone or changed, and what came in it has names that any system takes."""
        assert self._files() == self.before
        for path in self.work.rglob("*"):
            assert path.name.partition(".")[0] != "RUN"
            assert not [c for c in path.name if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp")], path
            assert len(os.fsencode(path.name)) <= 255

    @contextlib.contextmanager
    def attacked(self, refused: bool = True) -> Iterator[None]:
        """What is tried may be refused, in one line, unless `refused` is False; it is checked either way."""
        with contextlib.suppress(UserError) if refused else contextlib.nullcontext(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
        self.check()


@pytest.fixture
def place(tmp_path, monkeypatch) -> Place:
    """The folder is where relative paths begin, and home and Minari's folder lie in it."""
    found = Place(tmp_path / "place")
    monkeypatch.chdir(found.work)
    monkeypatch.setenv("DEADRECKON_HOME", str(found.work / "home"))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(found.work / "minari"))
    return found


class Hub:
    """A client whose server answers what an attacker wants, and which writes files where it is told to."""

    kind, commit, listed = "policy", "c0ffee", "policy.npz"

    def __init__(self, library_name: str):
        pass

    def repo_info(self, **asked):
        files = [SimpleNamespace(rfilename=file, size=len(self.text(file))) for file in ("deadreckon.json", self.listed)]
        return SimpleNamespace(sha=self.commit, siblings=files)

    def text(self, file: str) -> bytes:
        if file != "deadreckon.json":
            return b"evil"
        about = {"bytes": 4, "sha256": hashlib.sha256(b"evil").hexdigest()}
        return json.dumps({"format": 1, "kind": self.kind, "files": {self.listed: about}}).encode()

    def hf_hub_download(self, *, filename, local_dir, **asked):
        (Path(local_dir) / filename).parent.mkdir(parents=True, exist_ok=True)
        (Path(local_dir) / filename).write_bytes(self.text(filename))


class HubClient(ModuleType):
    """The module of that client."""

    HfApi = Hub


class Wandb(ModuleType):
    """W&B without a server, which writes an offline run in the folder that it is given, named by the id."""

    Settings = dict

    def setup(self):
        return SimpleNamespace(settings=SimpleNamespace(mode="offline", base_url="", project=None))

    def init(self, *, dir, id, **asked):
        (Path(dir) / "wandb" / f"offline-run-1-{id}").mkdir(parents=True)
        return SimpleNamespace(finish=lambda exit_code: None, starting_step=10**9)
