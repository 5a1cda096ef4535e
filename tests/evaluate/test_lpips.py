"""LPIPS against torchvision's layers written out, with random weights in the real files' layouts, and where
weights are looked for."""

import importlib
import sys

import pytest
import torch
from torch import nn

from samira_warp.evaluate import find_lpips
from samira_warp.evaluate.lpips import SMALLEST_IMAGE
from samira_warp.support.errors import UserError

FILES = {"alex": ("alexnet-owt-7be5be79.pth", "alex.pth"), "vgg": ("vgg16-397923af.pth", "vgg.pth")}
TAPS = {"alex": (1, 4, 7, 9, 11), "vgg": (3, 8, 15, 22, 29)}
VGG16 = (64, 64, "M", 128, 128, "M", 256, 256, 256, "M", 512, 512, 512, "M", 512, 512, 512, "M")
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


def features(net):
    """torchvision's ``features``, layer by layer."""
    if net == "alex":
        return nn.Sequential(
            *(
                nn.Conv2d(3, 64, kernel_size=11, stride=4, padding=2),
                nn.ReLU(),
                nn.MaxPool2d(kernel_size=3, stride=2),
            ),
            *(nn.Conv2d(64, 192, kernel_size=5, padding=2), nn.ReLU(), nn.MaxPool2d(kernel_size=3, stride=2)),
            *(nn.Conv2d(192, 384, kernel_size=3, padding=1), nn.ReLU()),
            *(nn.Conv2d(384, 256, kernel_size=3, padding=1), nn.ReLU()),
            *(
                nn.Conv2d(256, 256, kernel_size=3, padding=1),
                nn.ReLU(),
                nn.MaxPool2d(kernel_size=3, stride=2),
            ),
        )
    layers, channels = [], 3
    for width in VGG16:
        if width == "M":
            layers.append(nn.MaxPool2d(kernel_size=2, stride=2))
        else:
            layers += [nn.Conv2d(channels, width, kernel_size=3, padding=1), nn.ReLU()]
            channels = width
    return nn.Sequential(*layers)


class Written:
    """A backbone and head with random weights, and the distance as the paper's figure has it."""

    def __init__(self, net, folder):
        generator = torch.Generator().manual_seed(7)
        self.features, self.taps, self.net = features(net).requires_grad_(False), TAPS[net], net
        for layer in self.features:
            if isinstance(layer, nn.Conv2d):
                fan_in = layer.weight[0].numel()
                layer.weight.copy_(torch.randn(layer.weight.shape, generator=generator) * (2 / fan_in) ** 0.5)
                layer.bias.copy_(0.1 * torch.randn(layer.bias.shape, generator=generator))
        widths = [self.features[tap - 1].out_channels for tap in self.taps]
        self.heads = [torch.rand(1, width, 1, 1, generator=generator) for width in widths]
        backbone = {f"features.{key}": value for key, value in self.features.state_dict().items()}
        torch.save(backbone | {"classifier.1.weight": torch.zeros(2, 2)}, folder / FILES[net][0])
        torch.save(
            {f"lin{level}.model.1.weight": head for level, head in enumerate(self.heads)},
            folder / FILES[net][1],
        )
        self.folder = folder

    def distance(self, first, second):
        shift, scale = (torch.tensor(values)[:, None, None] for values in (SHIFT, SCALE))
        first, second = (
            ((image * 2 - 1).permute(2, 0, 1) - shift)[None] / scale for image in (first, second)
        )
        total, level = 0.0, 0
        for index, layer in enumerate(self.features[: self.taps[-1] + 1]):
            first, second = layer(first), layer(second)
            if index in self.taps:
                units = [
                    values / ((values**2).sum(dim=1, keepdim=True).sqrt() + 1e-10)
                    for values in (first, second)
                ]
                weighted = nn.functional.conv2d((units[0] - units[1]) ** 2, self.heads[level])
                total, level = total + weighted.mean(), level + 1
        return total


@pytest.fixture(scope="module", params=["alex", "vgg"])
def written(request, tmp_path_factory):
    return Written(request.param, tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def alex(tmp_path_factory):
    return Written("alex", tmp_path_factory.mktemp("alex"))


@pytest.fixture
def images(generator):
    return torch.rand(41, 50, 3, generator=generator), torch.rand(41, 50, 3, generator=generator)


@pytest.fixture
def no_weights(monkeypatch, tmp_path):
    """An empty torch.hub cache and no installed package."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    monkeypatch.setattr(torch.hub, "_hub_dir", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    return tmp_path / "hub" / "hub" / "checkpoints"


def test_the_distance_is_the_written_out_one(written, images):
    ours = find_lpips(written.net, written.folder)
    assert ours.net == written.net
    distance = ours(*images)
    assert distance.shape == ()
    # thirteen layers of float32 sums in another order
    assert distance.item() == pytest.approx(written.distance(*images).item(), rel=1e-4)
    assert distance.item() > 0.01


def test_equal_images_have_no_distance_and_order_does_not_matter(alex, images):
    ours = find_lpips("alex", alex.folder)
    assert ours(images[0], images[0]).item() == 0
    assert ours(*images).item() == pytest.approx(ours(images[1], images[0]).item(), rel=1e-6)


def test_the_gradient_is_the_written_out_ones(alex, images):
    prediction = images[0].clone().requires_grad_()
    find_lpips("alex", alex.folder)(prediction, images[1]).backward()
    expected = images[0].clone().requires_grad_()
    alex.distance(expected, images[1]).backward()
    error = (prediction.grad - expected.grad).norm() / expected.grad.norm()
    # float32 sums in another order; a rectifier at its kink may fall to the other side
    assert error < 1e-3


def test_the_gradient_is_finite_where_the_features_vanish(tmp_path):
    """Biases far below zero leave nothing at the taps."""
    alex = Written("alex", tmp_path)
    state = torch.load(tmp_path / FILES["alex"][0], weights_only=True)
    torch.save(
        {key: value - 100.0 if key.endswith("bias") else value for key, value in state.items()},
        tmp_path / FILES["alex"][0],
    )
    prediction = torch.rand(32, 32, 3, requires_grad=True)
    distance = find_lpips(alex.net, tmp_path)(prediction, torch.rand(32, 32, 3))
    distance.backward()
    assert distance.item() == 0
    assert prediction.grad.isfinite().all()


def test_it_is_frozen(alex):
    ours = find_lpips("alex", alex.folder)
    assert not list(ours.parameters())
    assert all(not buffer.requires_grad for buffer in ours.buffers())


@pytest.mark.parametrize("size", [(SMALLEST_IMAGE - 1, 64), (64, SMALLEST_IMAGE - 1)])
def test_small_images_are_refused(alex, size):
    with pytest.raises(UserError, match="32 pixels a side"):
        find_lpips("alex", alex.folder)(torch.rand(*size, 3), torch.rand(*size, 3))


def test_the_smallest_image_has_a_distance(written):
    image = torch.rand(SMALLEST_IMAGE, SMALLEST_IMAGE, 3)
    assert find_lpips(written.net, written.folder)(image, 1 - image).isfinite()


def link(source, folder, *names):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).symlink_to(source / name)


def test_weights_in_torch_hubs_cache(alex, no_weights, images):
    link(alex.folder, no_weights, *FILES["alex"])
    assert find_lpips("alex")(*images).item() == pytest.approx(alex.distance(*images).item(), rel=1e-4)


def test_a_head_in_an_installed_package_that_is_not_imported(alex, no_weights, images, tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    monkeypatch.setattr(torch.hub, "_hub_dir", None)
    package = tmp_path / "site" / "lpips"
    link(alex.folder, no_weights, FILES["alex"][0])
    link(alex.folder, package / "weights" / "v0.1", FILES["alex"][1])
    (package / "__init__.py").write_text("raise RuntimeError('the package was imported')")
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert find_lpips("alex")(*images).item() == pytest.approx(alex.distance(*images).item(), rel=1e-4)
    assert "lpips" not in sys.modules


@pytest.mark.parametrize("present", [(), (0,), (1,)])
def test_an_absent_file_is_a_reason(alex, no_weights, present):
    link(alex.folder, no_weights, *(FILES["alex"][index] for index in present))
    reason = find_lpips("alex")
    assert isinstance(reason, str)
    assert reason.startswith(FILES["alex"][1 if present == (0,) else 0])
    assert str(no_weights) in reason


def test_a_given_folder_is_the_only_one(alex, no_weights, tmp_path):
    link(alex.folder, no_weights, *FILES["alex"])
    (tmp_path / "empty").mkdir()
    reason = find_lpips("alex", tmp_path / "empty")
    assert isinstance(reason, str)
    assert str(tmp_path / "empty") in reason
    assert str(no_weights) not in reason


def test_weights_of_the_other_net_do_not_serve(alex):
    assert find_lpips("vgg", alex.folder).startswith(FILES["vgg"][0])


def test_a_folder_that_is_none(tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        find_lpips("alex", tmp_path / "nowhere")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UserError, match="a file"):
        find_lpips("alex", tmp_path / "file")


class Intruder:
    def __reduce__(self):
        return print, ("code in the file was run",)


def damage(kind, path):
    state = torch.load(path, weights_only=True)
    key = next(iter(state))
    match kind:
        case "text":
            path.write_text("hello")
        case "empty":
            path.write_bytes(b"")
        case "code":
            torch.save({key: Intruder()}, path)
        case "a missing key":
            del state[key]
            torch.save(state, path)
        case "another shape":
            torch.save(state | {key: state[key][:, 1:]}, path)
        case "numbers for tensors":
            torch.save(state | {key: 1.0}, path)
        case "a list":
            torch.save(list(state.values()), path)
    return key


@pytest.mark.parametrize("file", FILES["alex"])
@pytest.mark.parametrize(
    "kind", ["text", "empty", "code", "a missing key", "another shape", "numbers for tensors", "a list"]
)
def test_a_broken_file_is_named(alex, tmp_path, capsys, file, kind):
    for name in FILES["alex"]:
        (tmp_path / name).write_bytes((alex.folder / name).read_bytes())
    key = damage(kind, tmp_path / file)
    with pytest.raises(UserError) as caught:
        find_lpips("alex", tmp_path)
    message = str(caught.value)
    assert str(tmp_path / file) in message
    assert "\n" not in message
    assert (key in message) == (kind in ("a missing key", "another shape", "numbers for tensors", "a list"))
    assert capsys.readouterr() == ("", "")
