import shutil
import threading

import pytest
import torch
from data.damage import cut

from samira_warp.data import PixelCache, cache, load_pixels, open_listing
from samira_warp.support.errors import UserError

SIZE = {"width": 32, "height": 32}
# 16 bits for image, mask and albedo, the first four frames'; the last two have none
WITH_ALBEDO, WITHOUT = 32 * 32 * 7 * 2, 32 * 32 * 4 * 2


@pytest.fixture
def frames(tiny_dataset):
    return open_listing(tiny_dataset).frames


@pytest.fixture
def decoded(monkeypatch):
    """Names of the frames decoded, in order."""
    names = []

    def load(frame, **size):
        names.append(int(frame.name[:5]))
        return load_pixels(frame, **size)

    monkeypatch.setattr(cache, "load_pixels", load)
    return names


def ask(pixel_cache, *indices):
    for index in indices:
        pixel_cache[index]


def equal(first, second):
    if first.albedo is None or second.albedo is None:
        return (
            first.albedo is second.albedo
            and torch.equal(first.image, second.image)
            and torch.equal(first.mask, second.mask)
        )
    return all(
        torch.equal(getattr(first, name), getattr(second, name)) for name in ("image", "mask", "albedo")
    )


def test_eight_bit_frames_are_kept_exactly_enough(frames):
    with PixelCache(frames, resolution=32) as pixels:
        for index, frame in enumerate(frames):
            ours, direct = pixels[index], load_pixels(frame, **SIZE)
            # k / 255 is 257 k / 65535; both are rounded to float32
            torch.testing.assert_close(ours.image, direct.image, atol=6e-8, rtol=0)
            torch.testing.assert_close(ours.mask, direct.mask, atol=6e-8, rtol=0)
            assert (ours.albedo is None) == (direct.albedo is None)
            assert ours.image.dtype == ours.mask.dtype == torch.float32


def test_averages_are_kept_to_sixteen_bits(frames):
    with PixelCache(frames, resolution=20) as pixels:
        torch.testing.assert_close(
            pixels[0].image,
            load_pixels(frames[0], width=20, height=20).image,
            atol=0.5 / 65535 + 6e-8,
            rtol=0,
        )


def test_a_frame_is_decoded_once_within_the_budget(frames, decoded):
    with PixelCache(frames, resolution=32) as pixels:
        ask(pixels, *range(6), *range(6), 3, 0)
    assert decoded == list(range(6))


def bytes_of(frames, *indices):
    """What the cache counts for these frames."""
    with PixelCache(frames, resolution=32) as pixels:
        ask(pixels, *indices)
        return pixels.kept_bytes


def test_the_first_that_fit_stay(frames, decoded):
    budget = bytes_of(frames, 0, 1)
    decoded.clear()
    with PixelCache(frames, resolution=32, max_bytes=budget) as pixels:
        ask(pixels, 0, 1, 2)
        ask(pixels, 2, 1, 0, 2)
        assert pixels.kept_bytes == budget
        assert pixels.full
    assert decoded == [0, 1, 2, 2, 2]


def test_what_is_kept_follows_the_order_of_asking(frames, decoded, use_threads):
    """Threads may be done in any order: what stays is the same."""
    use_threads(4)
    budget = bytes_of(frames, 5, 3)
    decoded.clear()
    with PixelCache(frames, resolution=32, max_bytes=budget) as pixels:
        pixels.prefetch(range(6))
        ask(pixels, 5, 3, 0, 1, 2, 4)
        assert sorted(decoded) == list(range(6))
        ask(pixels, 5, 3)
        assert len(decoded) == 6
        ask(pixels, 0)
    assert decoded[6:] == [0]


def test_a_kept_frame_takes_less_than_its_sixteen_bits(frames):
    assert 0 < bytes_of(frames, 0) < WITH_ALBEDO
    assert 0 < bytes_of(frames, 5) < WITHOUT


def test_a_frame_larger_than_the_budget_is_decoded_each_time(frames, decoded):
    with PixelCache(frames, resolution=32, max_bytes=10) as pixels:
        ask(pixels, 4, 0, 0, 4)
        assert pixels.kept_bytes == 0
    assert decoded == [4, 0, 0, 4]


def test_no_budget_keeps_nothing_and_still_answers(frames, decoded):
    with PixelCache(frames, resolution=32, max_bytes=0) as pixels:
        first, second = pixels[0], pixels[0]
    assert decoded == [0, 0]
    assert equal(first, second)


def test_content_does_not_depend_on_how_a_frame_came(frames, use_threads):
    """Just decoded, kept, fetched ahead by any of several threads, and decoded again: the same bits."""
    use_threads(3)
    with (
        PixelCache(frames, resolution=20) as plain,
        PixelCache(frames, resolution=20, max_bytes=bytes_of(frames, 3)) as pressed,
    ):
        for order in ((3, 0, 5, 1, 4, 2), (2, 2, 0, 5)):
            pressed.prefetch(order)
            for index in order:
                assert equal(plain[index], plain[index])
                assert equal(plain[index], pressed[index])


def test_results_are_the_callers_own(frames):
    with PixelCache(frames, resolution=32) as pixels:
        before = pixels[0].image.clone()
        pixels[0].image.zero_()
        assert torch.equal(pixels[0].image, before)
        for _ in range(2):
            pixels.prefetch([0])
            ahead = pixels[0].image
            assert torch.equal(ahead, before)
            ahead.zero_()


@pytest.mark.parametrize("index", [0, 5])
def test_pixels_are_laid_out_row_by_row(frames, index):
    with PixelCache(frames, resolution=32) as pixels:
        found = pixels[index]
    assert all(values is None or values.is_contiguous() for values in vars(found).values())


@pytest.mark.gpu
def test_pinned_pixels_are_the_same_on_a_gpu(frames):
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device on this machine")
    with (
        PixelCache(frames, resolution=20) as plain,
        PixelCache(frames, resolution=20, pinned=True) as pinned,
    ):
        pinned.prefetch(range(6))
        for index in range(6):
            found = pinned[index]
            assert found.image.is_pinned()
            assert found.mask.is_pinned()
            there = found.to("cuda")
            del found  # its memory waits for the copy
            assert equal(there.to("cpu"), plain[index])


def test_frames_fetched_ahead_are_decoded_once(frames, decoded):
    with PixelCache(frames, resolution=32) as pixels:
        pixels[0]
        pixels.prefetch([0, 1, 2])
        pixels.prefetch([2, 1, 3])
        ask(pixels, 1, 2, 3, 0)
        assert decoded == [0, 1, 2, 3]


def test_several_threads_decode_at_once(frames, monkeypatch, use_threads):
    """Each of three waits for the other two."""
    use_threads(3)
    together = threading.Barrier(3)

    def load(frame, **size):
        together.wait(10)
        return load_pixels(frame, **size)

    monkeypatch.setattr(cache, "load_pixels", load)
    with PixelCache(frames, resolution=32) as pixels:
        pixels.prefetch(range(3))
        ask(pixels, 2, 0, 1)


def test_fetching_ahead_runs_beside_the_caller(frames, monkeypatch):
    threads = []

    def load(frame, **size):
        threads.append(threading.current_thread())
        return load_pixels(frame, **size)

    monkeypatch.setattr(cache, "load_pixels", load)
    with PixelCache(frames, resolution=32) as pixels:
        pixels.prefetch([0])
        pixels[0]
        pixels[1]
    assert threads[0] is not threading.main_thread()
    assert threads[1] is threading.main_thread()


def test_closing_ends_the_threads_and_drops_what_waits(frames, monkeypatch, use_threads):
    use_threads(1)
    started, go, names = threading.Event(), threading.Event(), []

    def load(frame, **size):
        names.append(frame.name)
        started.set()
        go.wait(10)
        return load_pixels(frame, **size)

    monkeypatch.setattr(cache, "load_pixels", load)
    before = threading.active_count()
    pixels = PixelCache(frames, resolution=32)
    pixels.prefetch(range(6))
    assert started.wait(10)
    threading.Timer(0.05, go.set).start()
    pixels.close()
    assert names == [frames[0].name]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("pixels")]
    assert threading.active_count() <= before + 1  # the timer may be ending
    assert pixels[2].image.shape == (32, 32, 3)
    pixels.close()


def test_a_cache_that_fetched_nothing_has_no_thread(frames):
    before = threading.active_count()
    with PixelCache(frames, resolution=32) as pixels:
        pixels[0]
        assert threading.active_count() == before


def test_a_broken_file_is_reported_when_its_frame_is_asked_for(tiny_dataset, tmp_path):
    root = shutil.copytree(tiny_dataset, tmp_path / "subject")
    path = root / "images" / "00001_00.png"
    whole = path.read_bytes()
    cut(path)
    with PixelCache(open_listing(root).frames, resolution=32) as pixels:
        pixels.prefetch(range(3))
        ask(pixels, 0, 2)
        for _ in range(2):
            with pytest.raises(UserError, match="whole PNG") as caught:
                pixels[1]
            assert str(path) in str(caught.value)
        path.write_bytes(whole)
        ask(pixels, 1)
