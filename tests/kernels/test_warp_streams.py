"""Warp's utilities in torch's streams, with stand-ins for a GPU's: two threads must not mix them up."""

import threading
import time
from types import SimpleNamespace

import pytest
import torch
import warp as wp

from samira_warp.kernels.runtime import stream_of, streams

GPU = torch.device("cuda", 1)


class Stream:
    """A stream of torch's and of Warp's; what it is made to wait for is written down."""

    def __init__(self, handle, log, *, capturing=False):
        self.cuda_stream, self.log, self.is_capturing = handle, log, capturing

    def wait_stream(self, other):
        self.log.append((self.cuda_stream, "waits for", other.cuda_stream))


@pytest.fixture
def gpu(monkeypatch):
    """A device whose current stream in Warp is one for all threads, while torch's is each thread's own."""
    machine = SimpleNamespace(log=[], own=threading.local(), current=None, inside=0, most=0)
    default = Stream(0, machine.log)

    class ScopedStream:
        """As Warp's: what was current before comes back at the end, whoever changed it meanwhile."""

        def __init__(self, stream, *, sync_enter):
            assert sync_enter is False
            self.stream = stream

        def __enter__(self):
            self.before, machine.current = machine.current, self.stream.cuda_stream

        def __exit__(self, *error):
            machine.current = self.before

    def wrap(alias, *, cuda_stream):
        assert alias == "cuda:1"
        return Stream(cuda_stream, machine.log, capturing=machine.own.stream.is_capturing)

    machine.stream = lambda handle, **more: Stream(handle, machine.log, **more)
    machine.default = default
    monkeypatch.setattr(wp, "Stream", wrap)
    monkeypatch.setattr(wp, "ScopedStream", ScopedStream)
    monkeypatch.setattr(wp, "capture_begin", lambda *, stream, **rest: machine.log.append(("begin", rest)))
    monkeypatch.setattr(wp, "capture_end", lambda *, stream: machine.log.append("end"))
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: machine.own.stream)
    monkeypatch.setattr(torch.cuda, "default_stream", lambda device: default)
    monkeypatch.setattr(streams, "_streams", {})
    return machine


def taken_by_another_thread(lock):
    """Whether another thread gets a lock; it gives it back."""
    got = []

    def work():
        got.append(lock.acquire(timeout=10))
        if got[0]:
            lock.release()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return got[0]


def test_each_threads_utilities_work_in_its_own_stream(gpu):
    """Four threads that stay a while in the stream that they have lent: no other is there meanwhile."""
    together, found = threading.Barrier(4), []

    def work(handle):
        gpu.own.stream = gpu.stream(handle)
        together.wait()
        for _ in range(25):
            with stream_of(GPU):
                for _ in range(4):
                    found.append((handle, gpu.current))
                    time.sleep(1e-4)

    threads = [threading.Thread(target=work, args=(7 + number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 400
    assert all(mine == current for mine, current in found)
    assert gpu.current is None


def test_a_thread_may_lend_its_stream_again_amid(gpu):
    """The collector may free a mesh within another utility's work."""
    gpu.own.stream = gpu.stream(7)
    with stream_of(GPU), stream_of(GPU):
        assert gpu.current == 7
    assert gpu.current is None


def test_the_default_stream_waits_before_and_after(gpu):
    gpu.own.stream = gpu.stream(7)
    with stream_of(GPU):
        assert gpu.log == [(0, "waits for", 7), (7, "waits for", 0)]
    assert gpu.log[2:] == [(0, "waits for", 7)]


def test_an_error_gives_the_stream_back(gpu):
    gpu.own.stream = gpu.stream(7)
    with pytest.raises(ZeroDivisionError), stream_of(GPU):
        _ = 1 / 0
    assert gpu.current is None
    assert gpu.log[2:] == [(0, "waits for", 7)]
    assert taken_by_another_thread(streams.WARP_STATE)


def test_the_default_stream_has_nobody_to_wait_for(gpu):
    gpu.own.stream = gpu.default
    with stream_of(GPU):
        assert gpu.current == 0
    assert gpu.log == []


def test_a_captured_stream_is_made_known_and_waits_for_nobody(gpu):
    gpu.own.stream = gpu.stream(7, capturing=True)
    with stream_of(GPU):
        assert gpu.log == [("begin", {"external": True, "force_module_load": False})]
    assert gpu.log[1:] == ["end"]


def test_a_stream_is_wrapped_once_for_all_threads(gpu, monkeypatch):
    made, slow = [], wp.Stream
    monkeypatch.setattr(
        wp, "Stream", lambda *names, **more: (time.sleep(0.01), made.append(1), slow(*names, **more))[-1]
    )
    together, found = threading.Barrier(4), []

    def work():
        gpu.own.stream = gpu.stream(7)
        together.wait()
        found.append(streams.current_stream(GPU))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [1]
    assert len(set(map(id, found))) == 1


def test_on_the_cpu_threads_do_not_wait_for_each_other():
    device = torch.device("cpu")
    inside = threading.Barrier(2, timeout=30)

    def work():
        with stream_of(device):
            inside.wait()

    other = threading.Thread(target=work)
    other.start()
    work()
    other.join()


@pytest.mark.gpu
def test_two_threads_sort_in_their_own_streams():
    """What a thread sorts is made in its own stream, behind a wait: a sort in another stream would come too
    early."""
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    device = torch.device("cuda", torch.cuda.current_device())
    wrong = []

    def work(seed):
        generator = torch.Generator().manual_seed(seed)
        stream = torch.cuda.Stream(device)
        with torch.cuda.stream(stream):
            for count in (1000, 50_000, 3000, 80_000) * 5:
                keys = torch.randint(1 << 30, (count,), generator=generator, dtype=torch.int32)
                room = torch.zeros(2, 2 * count, dtype=torch.int32, device=device)
                torch.cuda._sleep(1_000_000)
                room[0, :count] = keys.to(device, non_blocking=True)
                room[1, :count] = torch.arange(count, dtype=torch.int32, device=device)
                with stream_of(device):
                    wp.utils.radix_sort_pairs(wp.from_torch(room[0]), wp.from_torch(room[1]), count)
                expected = keys.sort(stable=True)
                same = torch.equal(room[0, :count].cpu(), expected.values)
                same &= torch.equal(room[1, :count].cpu().long(), expected.indices)
                wrong.extend([] if same else [count])

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
