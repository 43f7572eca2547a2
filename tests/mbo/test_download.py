"""Files of design problems from a server on this machine."""

import http.server
import io
import threading
import zipfile

import pytest

from deadreckon.cli.design import design
from deadreckon.data.transfer import RetryPolicy
from deadreckon.errors import UserError
from deadreckon.mbo.problems import download

PATIENT = RetryPolicy(tries=1, timeout=5, sleep=lambda seconds: None)


@pytest.fixture
def served(tmp_path, monkeypatch, home):
    """A folder that a server shows, and the package told to look there."""
    folder = tmp_path / "served"
    folder.mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(folder))

        def log_message(self, format, *args):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    root = f"http://127.0.0.1:{server.server_port}"
    sources = {name: source._replace(url=f"{root}/{name}") for name, source in download.SOURCES.items()}
    monkeypatch.setattr(download, "SOURCES", sources)
    yield folder
    server.shutdown()
    server.server_close()


def test_a_plain_file_and_one_in_a_zip(served, home, capsys):
    (served / "gfp").write_text("variant\tscore\n")
    place, new = download.get("gfp", retry=PATIENT)
    assert new
    assert place == home / "designs" / "avgfp.tsv"
    assert place.read_text() == "variant\tscore\n"
    (served / "gfp").write_text("other")
    assert download.get("gfp", retry=PATIENT) == (place, False)
    with zipfile.ZipFile(served / "superconductor", "w") as archive:
        archive.writestr("train.csv", "a,critical_temp\n")
        archive.writestr("unique_m.csv", "b\n")
    design(["get", "superconductor"])
    assert (home / "designs" / "superconductor.csv").read_text() == "a,critical_temp\n"
    assert capsys.readouterr().out.strip().endswith("superconductor.csv")
    assert sorted(path.name for path in place.parent.iterdir()) == ["avgfp.tsv", "superconductor.csv"]


def test_what_is_wrong_leaves_nothing_behind(served, home):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("other.csv", "x")
    for wrong in (content.getvalue(), b"no zip"):
        (served / "superconductor").write_bytes(wrong)
        with pytest.raises(UserError, match="no zip with train.csv in it; the file was removed"):
            download.get("superconductor", retry=PATIENT)
    with pytest.raises(UserError, match="404"):
        download.get("molecule", retry=PATIENT)
    with pytest.raises(UserError, match="unknown problem to download 'branin'"):
        download.get("branin")
    assert not (home / "designs" / "superconductor.csv").exists()
