"""What tests of several packages share."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from geoevs.core.isolate import THREAD_VARIABLES

TESTS = Path(__file__).parent

HEIGHT, WIDTH = 16, 24
"""Of the tiny pairs and masks that trainings are tested on."""

SLOW = (
    "workflow/",
    "baselines/emernerf/test_adapter.py",
    "baselines/freevs/test_task.py",
    "baselines/gaussians/test_nodes.py",
    "baselines/gaussians/test_training.py",
    "baselines/street_gaussians/test_adapter.py",
    "baselines/three_dgs/test_adapter.py",
    "config/test_snakemake.py",
    "detection/bevformer/test_learning.py",
    "generator/test_task.py",
    "geometry/test_depth_loss.py",
    "geometry/test_finetuning.py",
    "geometry/test_refinement.py",
    "methods/test_training.py",
    "protocol/test_misbehaving.py",
    "protocol/test_runs.py",
    "results/report/test_browser.py",
    "scenes/test_street.py",
)
"""Tests that `make check` leaves out: whole runs, a browser, and modules of 10 s or more, most of
which train, fit or render."""

# The same examples each time, however busy the machine: what passed once passes again, until
# somebody changes the code.
settings.register_profile("repeatable", derandomize=True, deadline=None)
# New examples each time, and many, and how many of each kind were used or refused:
# `pytest --hypothesis-profile long tests/test_fuzz.py tests/*/test_fuzz.py`.
BY_HAND = {
    "paper": "the paper's rules at its resolution",
    "detection": "detectors of all settings",
    "cluster": "runs whose jobs are sent elsewhere",
}
"""Marks of tests that run when they are asked for alone, and what takes so long."""

LONG = "long"
settings.register_profile(LONG, max_examples=3000, deadline=None)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes():
    """Processes that share the files get one thread each: idle ones spin, and slow the others."""
    os.environ |= dict.fromkeys(THREAD_VARIABLES, "1")


def pytest_configure(config):
    """Hide GPUs from all tests but theirs: the same bytes are promised on the CPU alone."""
    if config.option.markexpr != "cuda":
        os.environ["CUDA_VISIBLE_DEVICES"] = ""


@pytest.hookimpl(tryfirst=True)  # before `-m "not slow"` looks at the marks
def pytest_collection_modifyitems(items):
    """Mark slow tests. The smoke run's take longest: of two processes, one begins there."""
    items.sort(key=lambda item: item.path.name != "test_smoke.py")
    slow = tuple(f"{TESTS}/{name}" for name in SLOW)
    for item in items:
        if str(item.path).startswith(slow):
            item.add_marker("slow")


def pytest_terminal_summary(terminalreporter):
    """After many examples, say how many inputs of each kind were used or refused."""
    fuzzing = sys.modules.get("tests.fuzzing")
    if fuzzing is None or settings.get_current_profile_name() != LONG:
        return
    ends = [f"{what}, {end}" for what in ("sound", "broken") for end in ("used", "refused")]
    terminalreporter.section("inputs that were tried")
    terminalreporter.write_line(f"{'kind':32}" + "".join(f"{end:>17}" for end in ends))
    for kind, counts in sorted(fuzzing.COUNTS.items()):
        numbers = "".join(f"{counts[end]:17,}" for end in ends)
        terminalreporter.write_line(f"{kind:32}{numbers}")


def pytest_runtest_setup(item):
    """Skip what takes minutes unless it is asked for, and what needs a GPU where none is."""
    for mark, what in BY_HAND.items():
        if item.get_closest_marker(mark) and item.config.option.markexpr != mark:
            pytest.skip(f"{what} take minutes; run `pytest -m {mark}`")
    if item.get_closest_marker("cuda"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("tests on a GPU run by themselves, with `pytest -m cuda`, where one is")


@pytest.fixture
def networks():
    """Makers of networks so small that they run in milliseconds, and of images for them."""
    import numpy as np
    import torch
    from diffusers import AutoencoderKL, PNDMScheduler, UNet2DConditionModel

    from geoevs.core.networks import seeded
    from geoevs.diffusion.autoencoder import Autoencoder, to_tensor
    from geoevs.diffusion.condition_encoder import ConditionEncoder
    from geoevs.diffusion.denoiser import Denoiser, conditioned
    from geoevs.diffusion.prior import Prior
    from geoevs.diffusion.process import Diffusion
    from geoevs.generator.geo_evs.model import Generator

    def tiny_network(values, latent=4, levels=1):
        return AutoencoderKL(
            in_channels=values,
            out_channels=values,
            down_block_types=("DownEncoderBlock2D",) * levels,
            up_block_types=("UpDecoderBlock2D",) * levels,
            block_out_channels=(8,) * levels,
            layers_per_block=1,
            latent_channels=latent,
            norm_num_groups=4,
            mid_block_add_attention=False,
        )

    def tiny_unet(latent=4):
        return UNet2DConditionModel(
            in_channels=latent,
            out_channels=latent,
            block_out_channels=(8, 16),
            layers_per_block=1,
            norm_num_groups=4,
            down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
            up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
            cross_attention_dim=8,
            attention_head_dim=2,
        )

    def tiny_public_prior(folder, levels=2):
        """A tiny checkpoint as the Hugging Face repositories of latent-diffusion models are."""
        AutoencoderKL(
            block_out_channels=(8,) * levels,
            down_block_types=("DownEncoderBlock2D",) * levels,
            up_block_types=("UpDecoderBlock2D",) * levels,
            layers_per_block=1,
            norm_num_groups=4,
            latent_channels=4,
            scaling_factor=0.25,
        ).save_pretrained(folder / "vae")
        tiny_unet().save_pretrained(folder / "unet")
        # As Stable Diffusion 2.1's own: another sampler, but the same process.
        PNDMScheduler(
            beta_schedule="scaled_linear",
            beta_start=0.001,
            beta_end=0.02,
            prediction_type="epsilon",
        ).save_pretrained(folder / "scheduler")

    def smooth_images(count, height=16, width=24, seed=0):
        """(N, H, W, 3) uint8: images of a few colours each."""
        rng = np.random.default_rng(seed)
        corners = rng.uniform(30, 225, (count, 2, 2, 3))
        down, across = np.linspace(0, 1, height)[:, None, None], np.linspace(0, 1, width)[:, None]
        left, right = (
            corners[:, 0, None, None, k] * (1 - down) + corners[:, 1, None, None, k] * down
            for k in (0, 1)
        )
        return np.rint(left * (1 - across) + right * across).astype(np.uint8)

    class Makers:
        network, unet, images = map(staticmethod, (tiny_network, tiny_unet, smooth_images))
        public_prior = staticmethod(tiny_public_prior)

        @staticmethod
        def autoencoder(block=2, latent=4):
            with seeded(0, "autoencoder"):
                made = Autoencoder(tiny_network(3 * block**2, latent), block)
            if block > 1:
                made.fit_linear(to_tensor(smooth_images(8, 8 * block, 8 * block)))
            made.fit_statistics(to_tensor(smooth_images(8, 8 * block, 8 * block)))
            return made.eval()

        @classmethod
        def prior(cls, diffusion=None, block=2):
            autoencoder = cls.autoencoder(block)
            with seeded(0, "prior"):
                denoiser = Denoiser(tiny_unet(), None)
                torch.nn.init.normal_(denoiser.prompt)
            return Prior(autoencoder, denoiser.eval(), diffusion or Diffusion())

        @classmethod
        def generator(cls, diffusion=None, block=2, **encoder):
            """Untrained, but one that looks at its condition."""
            prior = cls.prior(diffusion, block)
            with seeded(0, "encoder"):
                made = ConditionEncoder(prior.autoencoder, channels=6, **encoder)
                denoiser = conditioned(prior.denoiser, made, prior.diffusion.prediction)
                torch.nn.init.normal_(denoiser.unet.conv_in.weight, std=0.3)
                torch.nn.init.normal_(denoiser.null)
            return Generator(prior.autoencoder, denoiser.eval(), prior.diffusion)

    return Makers


@pytest.fixture
def weights(networks, tmp_path):
    """A folder of pretrained weights, as `snakemake pretrain` makes it."""
    from geoevs.diffusion.prior import (
        AUTOENCODER_FILE,
        PRIOR_FILE,
        save_autoencoder,
        save_denoiser,
    )

    prior = networks.prior()
    save_autoencoder(tmp_path / "weights" / AUTOENCODER_FILE, prior.autoencoder)
    save_denoiser(tmp_path / "weights" / PRIOR_FILE, prior.denoiser, prior.diffusion)
    return tmp_path / "weights"


@pytest.fixture
def pairs(networks):
    """Eight pairs; of pair n, the n first of 16 rows are unknown."""
    import numpy as np

    from geoevs.conditions.pairs import Pairs

    target = networks.images(8)
    valid = np.arange(HEIGHT)[:, None] >= np.arange(8)[:, None, None]
    valid = np.broadcast_to(valid, (8, HEIGHT, WIDTH)).copy()
    names = np.array([f"scene-{n // 4}" for n in range(8)]), np.array(["front", "left"] * 4)
    return Pairs(target * valid[..., None], valid, target, *names, np.arange(8) // 2)


@pytest.fixture
def library():
    """Masks that hide the 6, 12 or 18 rightmost of 24 columns."""
    import numpy as np

    from geoevs.conditions.artifact_masks import MaskLibrary
    from geoevs.conditions.bits import pack_masks

    masks = np.arange(WIDTH) < WIDTH - 6 * np.arange(1, 4)[:, None, None]
    masks = np.broadcast_to(masks, (3, HEIGHT, WIDTH))
    labels = {"scene": np.full(3, "s"), "frame": np.arange(3)}
    labels |= {name: np.zeros(3) for name in ("yaw", "lateral")}
    return MaskLibrary(HEIGHT, WIDTH, pack_masks(masks), **labels, support=masks.mean(axis=(1, 2)))


@pytest.fixture
def geoevs(monkeypatch, capsys):
    """Runs the command in this process; gives exit code, standard output and standard error."""
    from geoevs.cli import main as cli

    def run(*arguments: object):
        monkeypatch.setattr(sys, "argv", ["geoevs", *map(str, arguments)])
        monkeypatch.setattr(cli, "_log", None)
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run
