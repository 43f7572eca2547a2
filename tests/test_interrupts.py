"""Signals end work where it can be gone on with, and the command says which command does."""

import gc
import os
import signal
import time
import types

import pytest

from deadreckon import interrupts
from deadreckon.cli import main as command
from deadreckon.interrupts import Interrupted, goes_on, holding, listening, resumable


@pytest.fixture
def heard():
    with listening(lambda number: None):
        yield


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_what_is_held_and_for_nothing_else(heard, number):
    done = []
    with pytest.raises(Interrupted) as caught, holding():  # noqa: PT012
        signal.raise_signal(number)
        done.append("chunk")
    assert done == ["chunk"]
    assert caught.value.number == number == interrupts.arrived()
    with pytest.raises(Interrupted), holding():  # something swallowed it: the next chunk does not begin
        done.append("never")
    assert done == ["chunk"]


def test_without_anything_held_it_ends_at_once(heard):
    with pytest.raises(Interrupted):
        signal.raise_signal(signal.SIGTERM)


def test_held_twice_the_outer_one_counts(heard):
    done = []
    with pytest.raises(Interrupted), holding():  # noqa: PT012
        with holding():
            signal.raise_signal(signal.SIGINT)
        done.append("inner")
    assert done == ["inner"]


def test_what_fails_while_a_signal_waits_fails_as_itself(heard):
    with pytest.raises(ZeroDivisionError), holding():  # noqa: PT012
        signal.raise_signal(signal.SIGINT)
        raise ZeroDivisionError
    with pytest.raises(Interrupted), holding():
        pass


def test_handlers_come_back_and_ignored_signals_stay_ignored():
    before = signal.getsignal(signal.SIGTERM)
    ignored = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with listening(lambda number: None):
            signal.raise_signal(signal.SIGINT)
            assert signal.getsignal(signal.SIGTERM) != before
        assert interrupts.arrived() is None
    finally:
        signal.signal(signal.SIGINT, ignored)
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_second_signal_ends_the_process_but_not_its_echo(monkeypatch):
    ended, last = [], []
    monkeypatch.setattr(os, "_exit", ended.append)
    times = iter([10.0, 10.4, 12.0])
    monkeypatch.setattr(interrupts, "time", types.SimpleNamespace(monotonic=lambda: next(times)))
    with listening(last.append), pytest.raises(Interrupted), holding():  # noqa: PT012
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # the terminal's and a wrapper's
        assert ended == []
        signal.raise_signal(signal.SIGTERM)
        assert (ended, last) == ([143], [signal.SIGTERM])


@pytest.mark.parametrize(("args", "kept", "number", "words"), [
    (["train", "--out", "a b"], "run.json", signal.SIGINT, "to continue: deadreckon train --out 'a b' --resume"),
    (["train", "--resume"], "run.json", signal.SIGTERM, "to continue: deadreckon train --resume"),
    (["train", "--out", "a b"], "", signal.SIGTERM, "the same command starts again"),
    (["ope", "--out", "x"], "fits", signal.SIGINT, "to continue: deadreckon ope --out x"),
    (["predict"], "", signal.SIGINT, "the same command starts again"),
    (["recommend"], "run.json", signal.SIGTERM, "recommend cannot be resumed; start again with another --out"),
])  # fmt: skip
def test_the_command_says_what_goes_on(args, kept, number, words, tmp_path, monkeypatch, capsys):
    if kept:
        (tmp_path / kept).touch()

    def work(given):
        with resumable(tmp_path / (kept or "nothing")):
            try:
                signal.raise_signal(number)
            except KeyboardInterrupt as error:
                if args[0] == "predict":
                    raise RuntimeError("what a library makes of it") from error
                raise

    monkeypatch.setattr(command.importlib, "import_module", lambda name: types.SimpleNamespace(**{args[0]: work}))
    assert command.main(args) == 128 + number
    assert capsys.readouterr().err == f"deadreckon: interrupted; {words}\n"


def test_what_ended_otherwise_leaves_no_word(tmp_path):
    with listening(lambda number: None):
        with pytest.raises(ZeroDivisionError), resumable(tmp_path):
            raise ZeroDivisionError
        with resumable(tmp_path):
            pass
        assert not goes_on()


def test_a_signal_within_a_callback_of_the_garbage_collector_is_not_lost(heard, capsys):
    def callback(phase, info):
        gc.callbacks.remove(callback)
        signal.raise_signal(signal.SIGTERM)  # whose error Python drops

    gc.callbacks.append(callback)
    with pytest.raises(Interrupted):  # noqa: PT012
        gc.collect()
        time.sleep(5.0)
    assert "ignored" not in capsys.readouterr().err
