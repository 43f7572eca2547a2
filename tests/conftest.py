"""What every test shares: checked shapes, the compilation cache, a private home, and real files where they are at hand."""

import gc
import html
import itertools
import json
import os
import re
import shutil
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from tests import shapes

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("DEADRECKON_TEST_DATA") or ROOT.parent / "shared" / "data")


def _pin() -> None:
    """Each worker of pytest-xdist on a core of its own: thread pools that share cores wait for one another."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker.startswith("gw") and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker[2:]) % len(cores)]})


_pin()  # before anything starts threads
shapes.check()  # before anything of the package is imported

from deadreckon.tasks.pixels import choose_opengl  # noqa: E402

choose_opengl()  # before anything imports MuJoCo, which looks for OpenGL once

from deadreckon.imports import trust  # noqa: E402

trust("tests", "studies_of_tests", "zoomed_studies_of_tests")  # suites in tests name agents and studies of these


@pytest.fixture(scope="session", autouse=True)
def _compilation_cache():
    """Compiled programs outlive the session, so that only the first run of the tests pays for them."""
    import jax

    jax.config.update("jax_disable_most_optimizations", os.environ.get(QUICK) == "1")
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


@pytest.fixture(scope="session")
def _homes(tmp_path_factory):
    """Folders that no test has had; not there yet, as most tests need none."""
    homes = tmp_path_factory.mktemp("homes")
    return (homes / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def home(_homes, monkeypatch):
    """A home folder of the test's own, so that nothing reads or fills the user's."""
    folder = next(_homes)
    monkeypatch.setenv("DEADRECKON_HOME", str(folder))
    return folder


@pytest.fixture(autouse=True)
def _platforms():
    """`deadreckon data collect` chooses JAX's for its process, which is not to be that of the next test."""
    before = os.environ.get("JAX_PLATFORMS")
    yield
    if before is None:
        os.environ.pop("JAX_PLATFORMS", None)


MAPS = Path("/proc/self/maps")  # of this process, on Linux
MANY = 24_000  # of them: about 5 GB. A process may have 65,530, and the compiler crashes beyond


OFTEN = 20  # tests of one file between two looks, where programs are fully optimised: a long one reaches the limit


def _forget_programs() -> None:
    """Every compiled program maps some memory, so a worker that has compiled very many forgets them."""
    if MAPS.exists() and MAPS.read_text().count("\n") > MANY:
        import jax

        jax.clear_caches()


@pytest.fixture(scope="module", autouse=True)
def _tests_done():
    """Counts the tests of a file, after which garbage is collected."""
    yield itertools.count(1)
    _forget_programs()
    gc.collect()
    gc.freeze()  # what is left are programs and modules: the next collection need not look through them again


@pytest.fixture(autouse=True)
def _programs_are_forgotten(_tests_done):
    """Within a file too, which only matters to slow tests."""
    yield
    if next(_tests_done) % OFTEN == 0 and os.environ.get(QUICK) != "1":
        _forget_programs()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of small real files; a test that needs it skips where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no real data at {DATA} (set DEADRECKON_TEST_DATA)")
    return DATA


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
LISTEN = "<script>window.errors = []; addEventListener('error', (e) => errors.push(String(e.message)));</script>"


@pytest.fixture(scope="session")
def browse(tmp_path_factory):
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        pytest.skip("no Chromium on this machine")

    def run(page, script):
        """What the script puts into `#found` after the page has loaded, and what the console said."""
        text = page.read_text()
        page = page.with_name(f"checked-{page.name}")
        page.write_text(text.replace("<style>", LISTEN + "<style>", 1).replace("</body>", script + "</body>"))
        profile = tmp_path_factory.mktemp("profile")
        done = subprocess.run(
            [browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", f"--user-data-dir={profile}", "--window-size=1280,1600",
             "--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom", page.as_uri()],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
        if found is None:
            pytest.fail(f"the page's script did not end: {done.stderr[-2000:]}")
        return json.loads(html.unescape(found[1])), [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return run


QUICK = "JAX_DISABLE_MOST_OPTIMIZATIONS"
FLAGS_KNOWN_BY = "0.10."  # versions of jaxlib: one that does not know a flag of XLA ends the process
# What compiles faster: no emitters of fused kernels, half of its time; no schedule for many cores; copies inserted without a
# search for those that could be spared; one module of code.
FLAGS = (
    "--xla_cpu_use_fusion_emitters=false --xla_cpu_enable_concurrency_optimized_scheduler=false"
    " --xla_cpu_copy_insertion_use_region_analysis=false --xla_cpu_parallel_codegen_split_count=1"
)
LONGEST = ("tests/test_golden.py", "tests/agents/", "tests/ope/", "tests/mbo/", "tests/runs/", "tests/training/")


def pytest_configure(config):
    """Programs of fast tests run for moments: to compile them fully costs more than it saves. Slow ones run as a user's do.

    Garbage is collected after each file: to look through all traced programs again and again takes a tenth of the time.
    """
    gc.disable()
    if config.option.markexpr == "not slow":
        os.environ.setdefault(QUICK, "1")  # commands that tests start inherit both
        if metadata.version("jaxlib").startswith(FLAGS_KNOWN_BY):
            os.environ.setdefault("XLA_FLAGS", FLAGS)


def pytest_collection_modifyitems(items):
    """What takes longest goes first, so that no worker is left alone with a long file at the end."""
    items.sort(key=lambda item: next((i for i, name in enumerate(LONGEST) if item.nodeid.startswith(name)), len(LONGEST)))
