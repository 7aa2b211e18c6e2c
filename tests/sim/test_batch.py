import os
import signal
import time

import pytest

from sim.batch import Lost, cores, in_processes


def double(number):
    return 2 * number


def double_unless_negative(number):
    if number == -1:
        raise ValueError("negative")
    if number == -9:
        os.kill(os.getpid(), signal.SIGKILL)
    return double(number)


def blas_threads(_):
    return os.environ["OPENBLAS_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def process(_):
    return os.getpid()


def sleep(seconds):
    time.sleep(seconds)
    return os.getpid()


def test_every_item_has_its_result():
    assert dict(in_processes(double, [1, 2, 3], 2)) == {1: 2, 2: 4, 3: 6}


def test_an_item_that_fails_stops_no_other():
    results = dict(in_processes(double_unless_negative, [1, -1, -9, 4, 5], 1))
    assert {k: results[k] for k in (1, 4, 5)} == {1: 2, 4: 8, 5: 10}
    assert results[-1] == Lost("ValueError: negative")
    lost = results[-9]
    assert isinstance(lost, Lost)
    assert "SIGKILL" in lost.why


def test_workers_use_one_blas_thread(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert list(in_processes(blas_threads, [0], 1)) == [(0, ("1", "1"))]


def test_workers_are_used_again():
    pids = {pid for _, pid in in_processes(process, [1, 2, 3], 1)}
    assert len(pids) == 1
    assert os.getpid() not in pids


def test_workers_end_when_the_loop_does():
    results = in_processes(sleep, [0.0, 600.0], 1)
    _, pid = next(results)
    assert isinstance(pid, int)
    results.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_there_is_a_core():
    assert cores() >= 1
