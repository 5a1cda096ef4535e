"""What a manifest may say, and which commands follow from it; no Ray."""

import pytest

from samira_warp.fleet.manifest import Resources, read_manifest
from samira_warp.fleet.results import Result, in_words, markdown
from samira_warp.fleet.stages import Stage, StageCrashError, run_stage, stages_of
from samira_warp.support.errors import UserError

WHOLE = """
[train]
max-steps = 30
jitter = false
ablate = ["no-mask", "no-albedo"]
split = "0.5"
[export]
env = "light.hdr"
[resources.train]
cores = 2
gpus = 0.5
memory-gb = 6
[[subject]]
name = "anna"
video = "films/anna.mp4"
prepare = { fps = 12.5 }
[[subject]]
name = "ben"
data = "ben"
train = { max-steps = 40, flame = "flame.pkl" }
"""


def read(tmp_path, text):
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return read_manifest(path)


def test_options_become_words(tmp_path):
    manifest = read(tmp_path, WHOLE)
    anna, ben = manifest.subjects
    assert anna.is_video
    assert anna.source == tmp_path / "films" / "anna.mp4"
    assert anna.options["prepare"] == ("--fps", "12.5")
    shared = ("--no-jitter", "--ablate", "no-mask", "no-albedo", "--split", "0.5")
    assert anna.options["train"] == ("--max-steps", "30", *shared)
    # its own before the others', and paths from the manifest's folder
    assert ben.options["train"] == ("--max-steps", "40", *shared, "--flame", str(tmp_path / "flame.pkl"))
    assert ben.options["export"] == ("--env", str(tmp_path / "light.hdr"))
    assert manifest.resources["train"] == Resources(2, 0.5, 6)
    assert manifest.resources["export"] == Resources(1, 0.0, 4.0)


def test_stages_of_a_film_and_of_a_dataset(tmp_path):
    manifest = read(tmp_path, WHOLE)
    anna, ben = (stages_of(subject, manifest, tmp_path / "out") for subject in manifest.subjects)
    assert [stage.name for stage in anna] == ["prepare", "train", "evaluate", "export"]
    assert [stage.name for stage in ben] == ["train", "evaluate", "export"]
    prepare, train = anna[0].commands[0], anna[1].commands[0]
    assert prepare[-2:] == ("--device", "cpu")  # it asked for no GPU
    assert "--device" not in train
    dataset = str(tmp_path / "out" / "anna" / "prepared" / "dataset")
    assert train[train.index("--data") + 1] == dataset
    assert "--resume" in train
    evaluate = anna[2].commands[1]
    assert evaluate[evaluate.index("--data") + 1] == dataset
    assert evaluate[evaluate.index("--split") + 1] == "0.5"
    assert ben[0].commands[0][ben[0].commands[0].index("--data") + 1] == str(tmp_path / "ben")


def test_other_options_are_another_stage_and_so_is_all_that_follows(tmp_path):
    def keys(text):
        manifest = read(tmp_path, text)
        return [stage.key for stage in stages_of(manifest.subjects[0], manifest, tmp_path / "out")]

    before = keys(WHOLE)
    assert keys(WHOLE) == before
    same, *others = zip(before, keys(WHOLE.replace("max-steps = 30", "max-steps = 31")), strict=True)
    assert same[0] == same[1]
    assert all(one != other for one, other in others)
    assert keys(WHOLE.replace("cores = 2", "cores = 1")) == before, "where it is done is not what is done"


MISTAKES = {
    "no TOML": ("[train", "a manifest in TOML"),
    "no subject": ("", "a .*subject.* at least, found none"),
    "an unknown table": ("[trian]\n" + WHOLE, "found trian, did you mean train"),
    "an unknown option": (WHOLE.replace("max-steps", "max-step"), "unknown option --max-step, did you mean"),
    "a value out of its choices": (WHOLE.replace("no-mask", "no-mouth"), "anna: train: expected options of"),
    "the fleet's own option": (WHOLE.replace("seed", "out").replace("flame =", "out ="), "found out"),
    "an unknown resource": (WHOLE.replace("gpus", "gpu"), "found gpu, did you mean gpus"),
    "half a core": (WHOLE.replace("cores = 2", "cores = 0.5"), "cores: expected a whole number from 1 on"),
    "no memory": (WHOLE.replace("memory-gb = 6", "memory-gb = 0"), "memory-gb: expected more than 0"),
    "two of one name": (WHOLE.replace("ben", "anna"), "expected one subject of this name, found 2"),
    "a name with a slash": (WHOLE.replace('"anna"', '"a/b"'), "subject 0: name"),
    "two sources": (WHOLE.replace('data = "ben"', 'data = "b"\nvideo = "v"'), "found video and data"),
    "no source": (WHOLE.replace('data = "ben"', ""), "ben: expected the path of a video"),
    "a date": (WHOLE.replace("fps = 12.5", "fps = 2026-01-01"), "prepare: fps: expected a word"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(tmp_path, name):
    text, message = MISTAKES[name]
    with pytest.raises(UserError, match=message):
        read(tmp_path, text)


def stage(folder, program, output=None):
    """A stage whose command is a shell's."""
    made = folder / "made"
    command = ("bash", "-c", program)
    return Stage("anna", "train", folder, (command,), output, (made,), "key", Resources())


def test_a_stage_is_done_once(tmp_path):
    work = stage(tmp_path, f"echo x >> {tmp_path}/made; echo $OMP_NUM_THREADS")
    assert run_stage(work).done
    assert run_stage(work).done
    assert (tmp_path / "made").read_text() == "x\n"
    assert (tmp_path / "stages" / "train.log").read_text() == "1\n"
    (tmp_path / "made").unlink()
    assert not work.done
    assert run_stage(work).done


def test_a_mistake_is_final_and_a_crash_is_not(tmp_path):
    outcome = run_stage(stage(tmp_path, "echo 'error: a: expected b, found c' >&2; exit 2"))
    assert (outcome.done, outcome.why) == (False, "a: expected b, found c")
    with pytest.raises(StageCrashError, match=r"ended by SIGKILL.* its last words: begun"):
        run_stage(stage(tmp_path, "echo begun; kill -9 $$"))
    with pytest.raises(StageCrashError, match="status 1; its last words: none"):
        run_stage(stage(tmp_path, "exit 1"))
    record = stage(tmp_path, "").record()
    assert (record["state"], record["tries"]) == ("failed", 3)


def test_output_is_whole_or_not_there(tmp_path):
    kept = tmp_path / "made"
    with pytest.raises(StageCrashError):
        run_stage(stage(tmp_path, "echo half; exit 1", kept))
    assert not kept.exists()
    assert run_stage(stage(tmp_path, "echo whole", kept)).done
    assert kept.read_text() == "whole\n"


def test_a_table_of_everything():
    done = Result(
        "anna", "done", "", "", 3700.0, {"psnr": 30.123, "ssim": 0.9, "lpips": None}, 10, 20_000, {}
    )
    failed = Result("ben", "failed", "prepare", "a | b <c>", 65.2, {}, None, None, {"log": "ben/x.log"})
    text = markdown([done, failed])
    assert "| anna | done | 30.12 | 0.9000 |  | 10 | 20,000 | 1 h 1 min |  |" in text
    assert "| ben | failed: prepare |  |  |  |  |  | 1 min 5 s | [log](ben/x.log) |" in text
    assert "- **ben**, prepare: a \\| b &lt;c>" in text
    assert in_words(3.4) == "3 s"
