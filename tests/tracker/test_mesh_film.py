import av
import numpy as np
import pytest
import torch
from kernels.meshes import sphere

from samira_warp.geometry.camera import Camera
from samira_warp.kernels import MeshTopology
from samira_warp.support.errors import UserError
from samira_warp.tracker.mesh_film import OPACITY, mesh_layers, write_mesh_video

WIDTH, HEIGHT, FOCAL, RADIUS = 96, 64, 120.0, 0.2
CAMERA = Camera(torch.eye(4), FOCAL, FOCAL, 48.0, 32.0, WIDTH, HEIGHT)


def spheres(frames, device="cpu"):
    """(N, V, 3) spheres that move to the right before the camera, a metre away, and their topology."""
    vertices, faces = sphere(rings=30, sectors=40)
    shift = torch.stack([0.05 * torch.arange(frames), torch.zeros(frames), torch.ones(frames)], dim=1)
    moved = RADIUS * vertices + shift[:, None]
    return moved.to(device), MeshTopology.build(faces.to(device), len(vertices))


def test_layers_are_bright_where_the_mesh_faces_the_camera(device):
    vertices, topology = spheres(1, device)
    layer = mesh_layers(vertices, topology, CAMERA)[0].cpu()
    assert layer.shape == (HEIGHT, WIDTH, 4)
    # the sphere's outline: a circle of radius f r / sqrt(d^2 - r^2)
    area = np.pi * FOCAL**2 * RADIUS**2 / (1 - RADIUS**2)
    assert layer[..., 3].sum().item() == pytest.approx(OPACITY * area, rel=0.01)
    assert layer[..., 3].max() <= OPACITY + 1e-6
    middle, side = layer[32, 48], layer[32, 48 + 22]
    assert middle[3].item() == pytest.approx(OPACITY, abs=1e-6)
    assert middle[2].item() == pytest.approx(OPACITY, rel=0.02)
    assert side[2] < 0.75 * middle[2]


def test_the_film_shows_pictures_meshes_and_landmarks(tmp_path):
    frames = 10
    vertices, topology = spheres(frames)
    pictures = (np.full((HEIGHT, WIDTH, 3), 200, np.uint8) for _ in range(frames))
    landmarks = np.full((frames, 2, 2), np.nan)
    landmarks[:, 0] = (10.0, 10.0)
    path = tmp_path / "mesh.mp4"
    write_mesh_video(
        path, pictures, vertices.split(4), topology, CAMERA, frames_per_second=20.0, landmarks=landmarks
    )
    with av.open(path) as film:
        assert film.streams.video[0].average_rate == 20
        shown = [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0)]
    assert len(shown) == frames
    # H.264 keeps grey to a few values, and colours at half the resolution
    for index, picture in enumerate(shown):
        assert picture.shape == (HEIGHT, WIDTH, 3)
        assert np.abs(picture[58, 88] - 200).max() < 8
        middle = picture[32, 48 + round(FOCAL * 0.05 * index)] if index < 6 else None
        if middle is not None:
            # 0.45 of 200, and 0.55 of (89, 191, 255)
            assert np.abs(middle - (139, 195, 230)).max() < 16
        dot = picture[8:12, 8:12].reshape(-1, 3)
        assert (dot[:, 2] < dot[:, 0] - 40).any()
    assert [entry.name for entry in tmp_path.iterdir()] == ["mesh.mp4"]


def test_too_few_pictures_leave_nothing_behind(tmp_path):
    vertices, topology = spheres(3)
    pictures = [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * 2
    with pytest.raises(ValueError, match="zip"):
        write_mesh_video(
            tmp_path / "mesh.mp4", pictures, [vertices], topology, CAMERA, frames_per_second=25.0
        )
    assert not list(tmp_path.iterdir())


def test_vertices_of_another_mesh_are_refused(tmp_path):
    vertices, topology = spheres(3)
    with pytest.raises(UserError, match=r"^vertices: "):
        write_mesh_video(
            tmp_path / "mesh.mp4", [], [vertices[:, 1:]], topology, CAMERA, frames_per_second=25.0
        )
