"""No two things draw the same numbers."""

import hashlib
import os
import subprocess
import sys
from itertools import product

from samira_subject.cast import build_cast
from samira_subject.streams import Purpose, generator_of, number_of


def test_streams_of_seeds_purposes_and_numbers_differ():
    keys = [(), (0,), (1,), (0, 0), (0, 1), (1, 0)]
    found = {}
    for seed, purpose, numbers in product((0, 1, 2, 5, 2**31 - 1), Purpose, keys):
        found[seed, purpose, numbers] = tuple(
            generator_of(seed, purpose, *numbers).integers(0, 2**62, 4).tolist()
        )
    assert len(set(found.values())) == len(found)


def test_a_number_is_a_stream_s_own_and_fits_a_kernel():
    numbers = [number_of(3, Purpose.RAYS, frame, light) for frame in range(40) for light in range(4)]
    assert len(set(numbers)) == len(numbers)
    assert all(0 <= number < 2**31 for number in numbers)
    assert numbers[5] == number_of(3, Purpose.RAYS, 1, 1)


def said_of_a_cast(seed):
    cast = build_cast(seed, texels=96)
    maps = (cast.materials.albedo, cast.materials.finish, cast.materials.resting)
    content = b"".join(value.numpy().tobytes() for value in (*maps, cast.identity))
    return f"{cast.template.hash} {hashlib.sha256(content).hexdigest()}"


def test_a_head_and_its_paint_are_the_same_in_any_process_for_any_number_of_threads():
    def making(threads):
        settings = {
            name: str(threads) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        }
        command = [sys.executable, __file__, "3"]
        return subprocess.Popen(command, env=os.environ | settings, stdout=subprocess.PIPE, text=True)

    # side by side: each takes seconds to shape a head
    with making(1) as first, making(2) as second:
        made = [process.communicate(timeout=300)[0] for process in (first, second)]
    assert first.returncode == second.returncode == 0
    assert made[0].strip() == made[1].strip() == said_of_a_cast(3)


if __name__ == "__main__":
    print(said_of_a_cast(int(sys.argv[1])))
