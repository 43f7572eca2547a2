"""How much memory a process may use."""

from deadreckon import memory


def test_a_containers_limit_counts_where_it_is_less(tmp_path, monkeypatch):
    whole = memory.memory()
    assert whole > 1e8
    for text, found in (("1000000\n", 1_000_000), ("max\n", None), ("9223372036854771712", None)):
        (tmp_path / "memory.max").write_text(text)
        monkeypatch.setattr(memory, "LIMITS", (str(tmp_path / "none"), str(tmp_path / "memory.max")))
        monkeypatch.setattr(memory.os, "sysconf", lambda name: {"SC_PHYS_PAGES": 10**6, "SC_PAGE_SIZE": 4096}[name])
        assert memory.memory() == (found or 4_096_000_000)
