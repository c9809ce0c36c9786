"""Signals are told of, one that comes again later interrupts, and afterwards all is as it was."""

import os
import signal
import threading
from types import SimpleNamespace

import pytest

from mckibben.storage import files
from mckibben.storage.files import SIGNALS, handle_signals


@pytest.fixture(params=SIGNALS)
def number(request):
    before = signal.signal(request.param, signal.SIG_DFL)  # a second one would end this process
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_is_told_and_a_later_one_interrupts(number, monkeypatch):
    told = []
    with handle_signals(told.append):
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)  # as a terminal that closes
        assert told == 2 * [number]
        monkeypatch.setattr(files, "_REPEAT_INTERVAL", -1.0)
        for again in (3, 4):
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), number)
            assert told == again * [number]
    assert signal.getsignal(number) == signal.SIG_DFL


def test_one_that_is_ignored_still_is(number):
    signal.signal(number, signal.SIG_IGN)
    told = []
    with handle_signals(told.append):
        os.kill(os.getpid(), number)
    assert not told and signal.getsignal(number) == signal.SIG_IGN


def test_another_thread_is_told_nothing(number):
    def work():
        with handle_signals(print):
            seen.append(signal.getsignal(number))

    seen = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.SIG_DFL]


def test_one_repeated_after_more_than_a_second_interrupts(number, monkeypatch):
    clock = iter([0.0, 0.0, 0.9, 0.9, 1.1, 1.1])
    monkeypatch.setattr(files, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with handle_signals(lambda _: None):
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
