import time

import pytest
import torch

from prt.errors import PrtError
from prt.metrics.timing import time_repeated


def test_counts_warms_up_and_synchronises_around_each_call():
    events = []
    timing = time_repeated(
        lambda: events.append("call"), repetitions=3, warmup=2, synchronise=lambda: events.append("sync")
    )
    assert events == ["call"] * 2 + ["sync", "call", "sync"] * 3
    assert timing.repetitions == 3
    assert timing.threads == torch.get_num_threads()
    assert timing.device


def test_median_and_95th_percentile(monkeypatch):
    durations = [0.0] + [
        float(i) for i in range(1, 22)
    ]  # one call of warm-up, then 1 to 21 s in the clock's words
    clock, calls = [0.0], iter(durations)

    def work():
        clock[0] += next(calls)

    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    timing = time_repeated(work, repetitions=21, warmup=1)
    assert timing.median == pytest.approx(11)
    assert timing.p95 == pytest.approx(20)


def test_time_waited_for_in_synchronise_is_counted():
    timing = time_repeated(lambda: None, repetitions=3, warmup=0, synchronise=lambda: time.sleep(0.01))
    assert timing.median >= 0.01


def test_result_is_plain_data():
    found = time_repeated(lambda: None, repetitions=2).to_dict()
    assert set(found) == {"median", "p95", "repetitions", "threads", "device"}


@pytest.mark.parametrize("wrong", [{"repetitions": 0}, {"warmup": -1}])
def test_wrong_counts_are_errors(wrong):
    with pytest.raises(PrtError, match="at least 1"):
        time_repeated(lambda: None, **wrong)
