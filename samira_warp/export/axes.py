"""The axes of splat formats. No converter turns them, and few formats say which they have.

    avatar, SPZ, glTF, USD  x to the head's left, y up, z to the front (RUB: right, up, back, of whoever looks
                            at the face)
    .ply                    x to the head's left, y down, z to the back (RDF: right, down, forward)

glTF and USD say so themselves. Of SPZ its library says that files hold RUB. Of .ply nobody says anything:
files have the axes of COLMAP's cameras, in which scenes of 3D Gaussian splatting are trained, and viewers
take y for down, or turn every file over.
"""

from __future__ import annotations

import torch

from samira_warp.export.splats import Splats


def down_forward(splats: Splats) -> Splats:
    """Splats in RDF, turned by 180 degrees about x from the avatar's axes."""
    flip = torch.tensor([1.0, -1.0, -1.0], device=splats.means.device)
    w, x, y, z = splats.quaternions.unbind(dim=1)
    # (0, 1, 0, 0) is the turn, to the left of every rotation
    return splats._replace(
        means=splats.means * flip,
        normals=splats.normals * flip,
        quaternions=torch.stack([-x, w, -z, y], dim=1),
    )
