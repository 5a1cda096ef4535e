import torch
from scipy.spatial import cKDTree
from subjects import camera, small_canonical

from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head.unwrap import GRAZING_COSINE, UnwrapView, unwrap
from samira_warp.kernels.mesh.uv_raster import rasterize_uv

SIZE = 128


def view_of(canonical, image, *, mask=None):
    view = camera(SIZE)
    if mask is None:
        mask = torch.ones(SIZE, SIZE)
    return UnwrapView(image, mask, canonical.vertices, view)


def unwrapped(views, canonical):
    return unwrap(views, atlas=canonical.atlas, vertices=canonical.vertices, faces=canonical.topology.faces)


def projected(canonical):
    """Pixel coordinates (h, w, 2) and the cosine (h, w) at which the camera sees each texel of the reference
    mesh."""
    view = camera(SIZE)
    points = canonical.positions
    normals = torch.nn.functional.normalize(
        canonical.atlas.positions(vertex_normals(canonical.vertices, canonical.topology.faces)), dim=-1
    )
    in_camera = points @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    pixels = in_camera[..., :2] / in_camera[..., 2:] * view.fx + torch.tensor([view.cx, view.cy])
    return pixels, (normals * torch.nn.functional.normalize(view.center - points, dim=-1)).sum(-1)


def coordinates():
    """An image whose colour is its own pixel coordinates, which bilinear sampling returns exactly."""
    y, x = torch.meshgrid(torch.arange(SIZE) + 0.5, torch.arange(SIZE) + 0.5, indexing="ij")
    return torch.stack([x, y, torch.zeros_like(x)], dim=-1) / SIZE


def covering_faces(canonical):
    """(h, w) long: the face that covers each texel's centre, -1 where none does."""
    atlas = canonical.atlas
    return rasterize_uv(atlas.vt, atlas.ft, size=atlas.size).face.long()


def eyeballs(canonical):
    """(h, w) bool: texels of the eyeballs, which lie under the surface."""
    hidden = torch.zeros(len(canonical.vertices), dtype=torch.bool)
    for name in ("left_eyeball", "right_eyeball"):
        hidden[torch.from_numpy(canonical.template.masks[name]).long()] = True
    faces = covering_faces(canonical)
    return hidden[canonical.topology.faces.long()].all(1)[faces.clamp(min=0)] & (faces >= 0)


def skin(canonical):
    """(h, w) bool: texels that some face covers, those of the eyeballs apart."""
    return (covering_faces(canonical) >= 0) & ~eyeballs(canonical)


def test_visible_texels_read_the_pixel_that_they_project_to():
    canonical = small_canonical()
    texture = unwrapped([view_of(canonical, coordinates())], canonical)
    pixels, cosine = projected(canonical)
    sure = skin(canonical) & (cosine > 2 * GRAZING_COSINE)
    assert sure.sum() > 100
    torch.testing.assert_close(texture[sure][:, :2], pixels[sure] / SIZE, atol=1e-4, rtol=0)


def test_what_no_view_sees_takes_its_mirror_images_value():
    """Only the right half of the picture is uncovered: the left half is filled in from it."""
    canonical = small_canonical()
    mask = torch.zeros(SIZE, SIZE)
    mask[:, SIZE // 2 :] = 1.0
    texture = unwrapped([view_of(canonical, coordinates(), mask=mask)], canonical)
    pixels, cosine = projected(canonical)
    front = skin(canonical) & (cosine > 2 * GRAZING_COSINE)
    known = front & (pixels[..., 0] > SIZE / 2 + 2)
    missing = front & (pixels[..., 0] < SIZE / 2 - 2)
    assert known.sum() > 30
    assert missing.sum() > 30
    assert texture[missing][:, 0].min() > 0.5
    # the sphere is symmetric, so the mirrored texel's pixel is the picture mirrored, to the spacing of known
    # texels
    mirrored = torch.stack([SIZE - pixels[..., 0], pixels[..., 1]], dim=-1)[missing] / SIZE
    spacing = (
        torch.from_numpy(cKDTree(pixels[known].numpy()).query(pixels[known].numpy(), k=2)[0][:, 1]).max()
        / SIZE
    )
    assert (texture[missing][:, :2] - mirrored).norm(dim=1).max() < 2 * spacing


def test_hidden_surfaces_read_nothing_of_their_own():
    """Eyeballs lie beneath the surface in front of them: they take the colour of what is seen, not the pixel
    before them."""
    canonical = small_canonical()
    image = torch.zeros(SIZE, SIZE, 3)
    seen = unwrapped([view_of(canonical, image)], canonical)
    assert (seen == 0).all()
    view = view_of(canonical, coordinates())
    alone = unwrapped([view], canonical)[eyeballs(canonical)]
    assert alone.isfinite().all()
    assert (alone.amax(1) > 0).all()


def test_texels_outside_the_atlas_take_the_mean_of_what_was_seen():
    canonical = small_canonical()
    texture = unwrapped([view_of(canonical, torch.full((SIZE, SIZE, 3), 0.25))], canonical)
    torch.testing.assert_close(texture, torch.full_like(texture, 0.25))
    bright = unwrapped([view_of(canonical, coordinates())], canonical)
    outside = bright[~canonical.atlas.valid]
    assert (outside == outside[0]).all()
    # the head is about the picture's centre
    assert (outside[0, :2] - 0.5).abs().max() < 0.15


def test_if_nothing_is_seen_everything_is_grey():
    canonical = small_canonical()
    texture = unwrapped([view_of(canonical, coordinates(), mask=torch.zeros(SIZE, SIZE))], canonical)
    assert (texture == 0.5).all()


def test_views_are_averaged():
    canonical = small_canonical()
    dark, bright = (view_of(canonical, torch.full((SIZE, SIZE, 3), value)) for value in (0.2, 0.6))
    texture = unwrapped([dark, bright], canonical)
    torch.testing.assert_close(texture, torch.full_like(texture, 0.4))


def test_shading_is_taken_off_what_it_shades():
    canonical = small_canonical()
    shading = 0.5 + torch.rand(len(canonical.vertices), 3, generator=torch.Generator().manual_seed(1))
    plain, shaded = view_of(canonical, torch.full((SIZE, SIZE, 3), 0.4)), torch.full((SIZE, SIZE, 3), 0.4)
    found = unwrapped([plain._replace(image=shaded, shading=shading)], canonical)
    _, cosine = projected(canonical)
    seen = skin(canonical) & (cosine > GRAZING_COSINE)
    expected = 0.4 / canonical.atlas.positions(shading)
    # float32 sums of weights of about one
    torch.testing.assert_close(found[seen], expected[seen], rtol=1e-5, atol=0)
    assert found.isfinite().all()


def test_what_no_view_sees_is_what_else_is_known():
    canonical = small_canonical()
    values = torch.rand(len(canonical.vertices), 3, generator=torch.Generator().manual_seed(2))
    found = unwrap(
        [view_of(canonical, torch.full((SIZE, SIZE, 3), 2.0))],
        atlas=canonical.atlas,
        vertices=canonical.vertices,
        faces=canonical.topology.faces,
        otherwise=values,
    )
    _, cosine = projected(canonical)
    away = canonical.atlas.valid & (cosine < 0)
    assert away.any()
    torch.testing.assert_close(found[away], canonical.atlas.positions(values)[away])
    assert (found[skin(canonical) & (cosine > GRAZING_COSINE)] == 2.0).float().mean() > 0.95
