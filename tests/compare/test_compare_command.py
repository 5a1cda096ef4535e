"""``python -m samira_warp.compare`` from run folders to its report, and what it refuses."""

import base64
import contextlib
import json
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from data.damage import change_json
from subjects import TESTS
from warm_start import warm_python

from samira_warp.compare.__main__ import command
from samira_warp.io.images import read_image, write_png

sys.path.append(str(TESTS / "view"))

from chromium import CHROMIUM, Browser

SIDE, TEST_FRAMES = 32, ("00004_00", "00005_00")
NAMES = {1: "eye", 2: "mouth"}
GAP, LINE = 2, 14
"""Pixels of a contact sheet of pictures this small: between them, and of the line under each."""


@pytest.fixture(scope="module")
def dataset(tiny_dataset, tmp_path_factory):
    """The tiny subject with labels: an eye in the upper left quarter, a mouth in the lower half."""
    folder = shutil.copytree(tiny_dataset, tmp_path_factory.mktemp("labelled") / "subject")
    (folder / "gt" / "parse").mkdir(parents=True)
    labels = np.zeros((SIDE, SIDE), np.uint8)
    labels[:16, :16], labels[16:] = 1, 2
    for name in TEST_FRAMES:
        write_png(folder / "gt" / "parse" / f"{name}.png", labels)
    (folder / "gt" / "parse.json").write_text(json.dumps(NAMES))
    return folder


@pytest.fixture(scope="module")
def runs(tiny_run, dataset, tmp_path_factory):
    """Two runs on the labelled subject; the second says that it had another seed, and scores otherwise."""
    folder = tmp_path_factory.mktemp("runs")
    made = [shutil.copytree(tiny_run, folder / name) for name in ("one", "<b> | two")]
    for run in made:
        change_json(run / "config.json", lambda record: record["settings"].update(data=str(dataset)))
    change_json(made[1] / "config.json", lambda record: record["settings"].update(seed=7))
    change_json(made[1] / "results.json", lambda results: results.update(psnr=results["psnr"] + 1.5))
    return made


@pytest.fixture(scope="module")
def html(runs, tmp_path_factory):
    out = tmp_path_factory.mktemp("html") / "new" / "report.html"
    assert command([*map(str, runs), "--out", str(out), "--device", "cpu"]) == 0
    return out


@pytest.fixture(scope="module")
def markdown(runs, tmp_path_factory):
    out = tmp_path_factory.mktemp("markdown") / "report.md"
    assert command([*map(str, runs), "--out", str(out), "--device", "cpu", "--frames", "1"]) == 0
    return out


class Read(HTMLParser):
    """Tables as rows of cells, addresses of all that is referred to, and the words."""

    def __init__(self, path):
        super().__init__()
        self.tables, self.addresses, self.bold, self.words, self._cell = [], [], [], [], None
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        self.addresses += [
            value for name, value in attributes if name in ("src", "href", "data", "xlink:href")
        ]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self._cell = True
        elif tag == "b":
            self.bold.append((len(self.tables) - 1, len(self.tables[-1]) - 1))

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cell = None

    def handle_data(self, data):
        self.words.append(data)
        if self._cell:
            self.tables[-1][-1][-1] += data


def test_the_report_holds_all_of_itself(html):
    read = Read(html)
    assert [path.name for path in html.parent.iterdir()] == ["report.html"]
    assert len(read.addresses) == 2
    curves, sheet = (
        base64.b64decode(address.partition(f"data:{kind};base64,")[2], validate=True)
        for address, kind in zip(read.addresses, ("image/svg+xml", "image/png"), strict=True)
    )
    assert ElementTree.fromstring(curves).tag.endswith("svg")
    assert sheet.startswith(b"\x89PNG")
    assert "http" not in html.read_text().replace("http://www.w3.org/2000/svg", "")


def test_only_settings_that_differ_are_there(html):
    (settings,) = [table for table in Read(html).tables if table[0][0] == "setting"]
    assert settings == [["setting", "one", "<b> | two"], ["--seed", "42", "7"]]


def test_scores_are_those_of_the_runs(html, runs):
    read = Read(html)
    results = [json.loads((run / "results.json").read_text()) for run in runs]
    number = next(number for number, table in enumerate(read.tables) if "SSIM" in table[0])
    scores, differences = read.tables[number : number + 2]
    assert scores[0] == ["run", "PSNR", "SSIM", "L1 x 100", "PSNR of the foreground"]
    for row, name, result in zip(scores[1:], ("one", "<b> | two"), results, strict=True):
        assert row[0] == name
        assert row[1:3] == [f"{result['psnr']:.2f}", f"{result['ssim']:.4f}"]
    assert differences == [["less one", *scores[0][1:]], ["<b> | two", "+1.50", "+0.0000", "+0.000", "+0.00"]]
    # the second one's PSNR is the better one; nothing else is
    assert [place for place in read.bold if place[0] == number] == [(number, 2)]
    assert any("No LPIPS" in words for words in read.words)


def test_scores_by_region_are_those_of_the_verbs(html, runs, dataset, tmp_path, capsys):
    from samira_warp.__main__ import main

    pictures = ["--avatar", str(runs[0]), "--out", str(tmp_path / "pictures"), "--device", "cpu"]
    assert main(["render", *pictures]) == 0
    capsys.readouterr()
    labels = ["--regions", str(dataset / "gt" / "parse")]
    assert main(["evaluate", "--pred", str(tmp_path / "pictures"), "--data", str(dataset), *labels]) == 0
    theirs = json.loads(capsys.readouterr().out)["regions"]
    psnr, _, ssim, _ = (table for table in Read(html).tables if table[0][1:] == ["eye", "mouth"])
    assert psnr[1] == ["one", *(f"{theirs[region]['psnr']:.2f}" for region in ("eye", "mouth"))]
    assert ssim[1] == ["one", *(f"{theirs[region]['ssim']:.4f}" for region in ("eye", "mouth"))]


def cells(sheet, columns):
    """Pictures of a contact sheet, row by row."""
    height, width = SIDE + LINE + GAP, SIDE + GAP
    rows = (sheet.shape[0] - GAP) // height
    return [
        sheet[GAP + row * height :, GAP + column * width :][:SIDE, :SIDE]
        for row in range(rows)
        for column in range(columns)
    ]


def test_the_sheet_shows_the_truth_the_renderings_and_their_errors(markdown, runs, dataset, tmp_path):
    from samira_warp.__main__ import main

    assert main(["render", "--avatar", str(runs[0]), "--out", str(tmp_path), "--device", "cpu"]) == 0
    rendered = read_image(tmp_path / "image" / f"{TEST_FRAMES[0]}.png", channels=3)
    sheet = read_image(markdown.parent / "report_pictures" / "frames.png", channels=3)
    truth, one, two, scale, error, _ = cells(sheet, 3)
    np.testing.assert_array_equal(one, rendered)
    np.testing.assert_array_equal(two, rendered)
    assert len(cells(sheet, 3)) == 6
    # the colours of errors rise in lightness with them: their order is that of the differences
    difference = np.abs(truth - rendered).mean(axis=2)
    lightness = error @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    order = np.argsort(difference.ravel(), kind="stable")
    rises = np.diff(lightness.ravel()[order])
    # truth and errors are rounded to 8 bits, which may change places of neighbours by so much
    assert rises.min() > -0.05
    assert lightness.ravel()[order[-1]] - lightness.ravel()[order[0]] > 0.2
    assert scale.std() > 0.1


def test_markdown_refers_to_the_pictures_beside_it(markdown):
    text = markdown.read_text(encoding="utf-8")
    files = re.findall(r"!\[[^\]]*\]\(<([^>]*)>\)", text)
    assert files == ["report_pictures/curves.svg", "report_pictures/frames.png"]
    assert sorted(path.name for path in markdown.parent.iterdir()) == ["report.md", "report_pictures"]
    assert sorted(path.name for path in (markdown.parent / "report_pictures").iterdir()) == [
        "curves.svg",
        "frames.png",
    ]
    # names are no markup: as many cells in every row
    assert r"\<b\> \| two" in text
    for table in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1


def test_curves_are_what_was_logged(markdown, runs):
    """Panels by panels: loss, PSNR and test PSNR, each over steps and over minutes, a line a run."""
    root = ElementTree.parse(markdown.parent / "report_pictures" / "curves.svg").getroot()
    space = {"svg": "http://www.w3.org/2000/svg"}
    panels = [group for group in root.findall("svg:g", space) if group.find("svg:text", space) is not None]
    titles = [panel.find("svg:text", space).text for panel in panels]
    numbers = ("loss", "PSNR of training frames, dB", "PSNR of a few test frames, dB")
    assert titles == [f"{number}, over {along}" for number in numbers for along in ("steps", "minutes")]
    logged = [json.loads(line) for line in (runs[0] / "metrics.jsonl").read_text().splitlines()]
    for panel, name in zip(panels[::2], ("loss", "psnr", "test_psnr"), strict=True):
        lines = [line.get("points").split() for line in panel.findall("svg:polyline", space)]
        assert len(lines) == 2
        points = np.array([point.split(",") for point in lines[0]], float)
        values = [line[name] for line in logged if name in line]
        assert len(points) == len(values)
        # larger values are further up, and the last step is at the right end
        assert np.sign(np.diff(points[:, 1])).tolist() == (-np.sign(np.diff(values))).tolist()
        assert points[-1, 0] == max(points[:, 0])


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_browser_shows_it(html, tmp_path):
    browser = Browser(tmp_path)
    try:
        page = browser.open(html.resolve().as_uri())
        page.until("document.readyState === 'complete' && document.images.length === 2")
        sizes = page.evaluate("[...document.images].map(image => [image.naturalWidth, image.naturalHeight])")
        assert sizes[1] == [3 * (SIDE + GAP) + GAP, 4 * (SIDE + LINE + GAP) + GAP]
        assert min(sizes[0]) > 300
        assert (
            page.evaluate(
                "performance.getEntriesByType('resource').filter("
                "entry => !entry.name.startsWith('data:')).length"
            )
            == 0
        )
        assert page.evaluate("document.querySelector('h1').innerText") == "one | <b> | two"
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        assert page.screenshot().std() > 10.0
    finally:
        browser.end()


def test_a_dataset_that_is_gone_is_said_and_another_place_can_be_named(runs, dataset, tmp_path, capsys):
    made = [shutil.copytree(run, tmp_path / f"run{number}") for number, run in enumerate(runs)]
    for run in made:
        change_json(
            run / "config.json", lambda record: record["settings"].update(data=str(tmp_path / "gone"))
        )
        lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
        for line in lines:
            line.pop("seconds")
            line.pop("test_psnr", None)
        (run / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    words = [*map(str, made), "--out", str(tmp_path / "a.md"), "--device", "cpu"]
    assert command(words) == 0
    text = (tmp_path / "a.md").read_text()
    assert "What was filmed cannot be shown" in text
    assert "by region" not in text
    assert "Without the time, which was not logged then: run0, run1." in text
    assert "Without test frames on the way, which were not logged then: run0, run1." in text
    assert "not logged" in text
    sheet = read_image(tmp_path / "a_pictures" / "frames.png", channels=3)
    assert sheet.shape[:2] == (2 * (SIDE + LINE + GAP) + GAP, 2 * (SIDE + GAP) + GAP)
    assert command([*words, "--data", str(dataset)]) == 0
    assert "by region" in (tmp_path / "a.md").read_text()


def refused(capsys, *words):
    capsys.readouterr()
    with contextlib.suppress(SystemExit):  # what tyro refuses ends the process
        assert command([*map(str, words), "--device", "cpu"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("error: ")
    return line


def unfinished(run):
    change_json(run / "config.json", lambda record: record.update(steps=50))


def unscored(run):
    (run / "results.json").unlink()


def without_avatar(run):
    shutil.rmtree(run / "avatar")
    metrics = (run / "metrics.jsonl").read_text().splitlines()
    (run / "metrics.jsonl").write_text(metrics[0] + "\n")


def other_data(run):
    change_json(
        run / "config.json", lambda record: record.update(frames_hash="0123456789abcdef", subject="her")
    )


def newer_format(run):
    change_json(run / "avatar" / "avatar.json", lambda values: values.update(format=99))


def no_run(run):
    (run / "config.json").unlink()


def broken_scores(run):
    change_json(run / "results.json", lambda results: results.update(ssim="good"))


@pytest.mark.parametrize(
    ("damage", "fragment"),
    [
        (unfinished, "expected a run that has finished, found one at step 6 of 50"),
        (unscored, "expected a run that has finished, found one that has not been scored"),
        (without_avatar, "expected a run that has finished, found one at step 3 of 6"),
        (other_data, "frames_hash: expected the data of {one}, subject ("),
        (other_data, "found her (0123456789ab)"),
        (newer_format, "found format 99, which a newer version of this package wrote"),
        (no_run, "expected a run folder, found no config.json in it"),
        (broken_scores, "results.json: ssim: expected a score, found 'good'"),
    ],
)
def test_a_run_that_cannot_be_compared_is_one_line_and_status_two(runs, tmp_path, capsys, damage, fragment):
    bad = shutil.copytree(runs[1], tmp_path / "bad")
    damage(bad)
    out = tmp_path / "new" / "report.html"
    line = refused(capsys, runs[0], bad, "--out", out)
    assert str(bad) in line
    assert fragment.format(one=runs[0]) in line
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]


@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        (["{one}", "--out", "{tmp}/a.html"], "two run folders or more"),
        (
            ["{one}", "{one}/../one", "--out", "{tmp}/a.html"],
            "expected runs that are not the same, found it twice",
        ),
        (["{one}", "{tmp}/none", "--out", "{tmp}/a.html"], "expected a run folder, found no such folder"),
        (["{one}", "{two}", "--out", "{tmp}/a.pdf"], "--out: expected a name that ends in .html or"),
        (["{one}", "{two}", "--out", "{tmp}/a.md", "--frames", "0"], "--frames: expected a positive number"),
        (["{one}", "{two}", "--out", "{tmp}/a.md", "--data", "{tmp}/none"], "expected a dataset's folder"),
        (["{one}", "{two}", "--out", "{tmp}/a.md", "--regions", "{tmp}"], "parse.json: expected the names"),
        (["{one}", "{two}", "--out", "/dev/null/a.md"], "/dev/null"),
        (["{one}", "{two}"], "--out"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_two(runs, tmp_path, capsys, more, fragment):
    names = {"one": runs[0], "two": runs[1], "tmp": tmp_path}
    assert fragment in refused(capsys, *(word.format(**names) for word in more))
    assert list(tmp_path.iterdir()) == []


def test_the_command_itself(runs, tmp_path):
    """As a user types it, by the one command before all verbs."""
    words = [*map(str, runs), "--out", "report.html", "--frames", "1", "--device", "cpu"]
    done = subprocess.run(
        [*warm_python(), "-m", "samira_warp", "compare", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "report.html\n"
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert Path(tmp_path / "report.html").read_text().startswith("<!DOCTYPE html>")
