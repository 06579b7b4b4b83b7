"""On a GPU: the same depth, and a projection that is the CPU's to the last bit."""

import numpy as np
import pytest
import torch

from geoevs.geometry.vggt import load_vggt
from geoevs.methods.tiny import tiny_camera, tiny_truth
from geoevs.projection import VISIBILITIES, project_points, unproject_depth, zbuffer

pytestmark = pytest.mark.cuda


def test_vggt_is_the_cpus_but_for_rounding(small_vggt, tiny):
    images = np.stack([tiny.image(name, 0) for name in tiny.cameras]).astype(np.float32)
    seen = torch.from_numpy(images).permute(0, 3, 1, 2)[None]
    model = load_vggt(small_vggt)
    with torch.inference_mode():
        here = model(seen).depth
        there = model.to("cuda")(seen.cuda()).depth.cpu()
    torch.testing.assert_close(there, here, rtol=1e-2, atol=1e-2)


def test_projection_is_the_cpus_bit_for_bit():
    source = tiny_camera("front", 10.0, np.array([0.0, 0.0, 1.6]))
    target = tiny_camera("virtual", -7.0, np.array([0.3, 0.9, 1.5]))
    depth = torch.from_numpy(tiny_truth(source).depth)
    points, pixels = unproject_depth(depth, source)
    there, its_pixels = unproject_depth(depth.cuda(), source)
    assert torch.equal(there.cpu(), points)
    assert torch.equal(its_pixels.cpu(), pixels)
    for here, found in zip(
        project_points(points, target), project_points(points.cuda(), target), strict=True
    ):
        assert found.cpu().numpy().tobytes() == here.numpy().tobytes()
    for visibility in VISIBILITIES:
        for here, found in zip(
            zbuffer(points, target, visibility),
            zbuffer(points.cuda(), target, visibility),
            strict=True,
        ):
            assert torch.equal(found.cpu(), here)
