"""On a GPU: Geo-EVS at 512 x 512 in bfloat16, and the kernels that CUDA has beside our own.

python -m benchmarks.cuda
"""

import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numba
import numpy as np
import torch
from diffusers import AutoencoderKL, UNet2DConditionModel
from rich.console import Console
from rich.table import Table
from torch import Tensor

from baselines.emernerf import hash_grid
from baselines.emernerf.tcnn_backend import tcnn_installed
from baselines.gaussians.model import Gaussians
from baselines.gaussians.nodes import Background, SceneGraph
from baselines.gaussians.rasterizer import rasterize_gaussians
from baselines.gaussians.training import Photo, Trainer, make_strategy
from benchmarks import hash_grid as points_on_levels
from benchmarks.projection import processor
from benchmarks.rasterizer import GAUSSIANS, SIZE, camera, cotangents, scattered_gaussians
from geoevs.conditions.artifact_masks import MaskLibrary
from geoevs.conditions.bits import pack_masks
from geoevs.conditions.injection import ArtifactInjection
from geoevs.conditions.pairs import Pairs
from geoevs.core.networks import mixed_precision
from geoevs.core.optimising import Optimisation, optimise
from geoevs.core.randomness import Rng
from geoevs.diffusion.autoencoder import Autoencoder
from geoevs.diffusion.denoiser import Denoiser
from geoevs.diffusion.prior import NANO, Prior, load_prior
from geoevs.diffusion.process import Diffusion
from geoevs.diffusion.sampling import Sampling
from geoevs.generator.geo_evs.model import Generator
from geoevs.generator.geo_evs.task import GeoEvsTask
from geoevs.generator.geo_evs.training import Settings
from geoevs.geometry.vggt import VGGT_1B, VGGT_NANO, VggtConfig, new_vggt
from geoevs.methods.contract import Budget, Views
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import write_tiny_scene

WEIGHTS = Path(__file__).parents[1] / "geoevs/weights"
PIXELS, BATCH, VIEWS = 512, 16, 5
PAPER, FAST = Sampling(30, 1.5, "ddim", 1), Sampling(1, 1.0, "ddim", 1)
STEPS = 21  # of a training; the first ones choose kernels
LARGE = "Stable Diffusion 2.1's size, random weights"


class Enough(Exception):  # noqa: N818
    """Ends a training that was long enough to be timed."""


def median_ms(run: Callable[[], object], rounds: int = 21) -> float:
    """Median milliseconds of a call, GPU included, after three others."""
    seconds = []
    for _ in range(rounds + 3):
        torch.cuda.synchronize()
        start = time.perf_counter()
        run()
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return 1000 * float(np.median(seconds[3:]))


def large_prior() -> Prior:
    """The networks of Stable Diffusion 2.1, unpretrained: their speed is the same."""
    network = AutoencoderKL(
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        block_out_channels=(128, 256, 512, 512),
        layers_per_block=2,
    )
    unet = UNet2DConditionModel(
        sample_size=64,
        block_out_channels=(320, 640, 1280, 1280),
        cross_attention_dim=1024,
        attention_head_dim=(5, 10, 20, 20),
        use_linear_projection=True,
    )
    diffusion = Diffusion("epsilon", "scaled_linear")
    return Prior(Autoencoder(network).eval(), Denoiser(unet, None).eval(), diffusion)


def training_set() -> tuple[Pairs, MaskLibrary]:
    """Pairs of noise with half of their pixels, and masks that hide a quarter."""
    rng, count = np.random.default_rng(0), 2 * BATCH
    target = rng.integers(256, size=(count, PIXELS, PIXELS, 3), dtype=np.uint8)
    valid = rng.random((count, PIXELS, PIXELS)) < 0.5
    names = np.full(count, "scene"), np.full(count, "front"), np.arange(count)
    masks = np.broadcast_to(np.arange(PIXELS) < 0.75 * PIXELS, (3, PIXELS, PIXELS))
    labels = {"scene": np.full(3, "s"), "frame": np.arange(3)}
    labels |= {name: np.zeros(3) for name in ("yaw", "lateral")}
    library = MaskLibrary(PIXELS, PIXELS, pack_masks(masks), **labels, support=np.full(3, 0.75))
    return Pairs(target * valid[..., None], valid, target, *names), library


def geo_evs(prior: Prior, paper: bool) -> list[str]:
    """Train and sample; cells of a row."""
    pairs, library = training_set()
    settings = Settings(
        prediction=None,
        timesteps="uniform",
        steps=10**6,
        batch=BATCH,
        learning_rate=1e-4,
        validity=not paper,
        filled=not paper,
    )
    torch.cuda.reset_peak_memory_stats()
    prior.autoencoder.to("cuda")
    injection = ArtifactInjection("reprojected", 0.4, PIXELS, PIXELS, library)
    task = GeoEvsTask(prior, pairs, injection, settings, 0)
    times: list[float] = []

    def report(loss: float) -> None:
        torch.cuda.synchronize()
        times.append(time.perf_counter())
        if len(times) > STEPS:
            raise Enough

    with tempfile.TemporaryDirectory() as work:
        try:
            optimise(task, Optimisation(settings.steps, 1e-4), 0, "timed", Path(work), report)
        except Enough:
            seconds = float(np.median(np.diff(times[3:])))
    trained = torch.cuda.max_memory_allocated() / 2**30
    torch.cuda.reset_peak_memory_stats()
    generator = Generator(prior.autoencoder, task.model.eval(), prior.diffusion)
    shown = pairs.rgb.astype(np.float32) / 255
    cells = [f"{BATCH / seconds:.1f}", f"{trained:.1f}"]
    for sampling in (FAST, PAPER):
        for count in (1, BATCH):
            conditions, valid = shown[:count], pairs.valid[:count]
            random = torch.Generator().manual_seed(0)
            ms = median_ms(lambda: generator.generate(conditions, valid, sampling, random), 5)  # noqa: B023
            cells.append(f"{ms / count:.1f}")
    return [*cells, f"{torch.cuda.max_memory_allocated() / 2**30:.1f}"]


def geo_evs_table() -> Table:
    """Throughput of both sizes."""
    table = Table("networks", "training, images/s", "GiB", title=f"Geo-EVS, {PIXELS} x {PIXELS}")
    for name in ("T = 1", "T = 30, guidance 1.5"):
        table.add_column(f"{name}: ms an image")
        table.add_column(f"{BATCH} at once")
    table.add_column("GiB")
    table.add_row("ours", *geo_evs(load_prior(NANO, WEIGHTS), paper=False))
    torch.cuda.empty_cache()
    table.add_row(LARGE, *geo_evs(large_prior(), paper=True))
    torch.cuda.empty_cache()
    return table


def vggt_table() -> Table:
    """Depth of a frame's views."""
    table = Table("network", "parameters", "ms a frame", title=f"VGGT, {VIEWS} views of 518 x 518")
    images = torch.rand(1, VIEWS, 3, 518, 518, device="cuda")
    for name, config in {"nano": VGGT_NANO, "1B, random weights": VGGT_1B}.items():
        table.add_row(name, *_vggt_cells(config, images))
    return table


def _vggt_cells(config: VggtConfig, images: Tensor) -> list[str]:
    model = new_vggt(config, torch.Generator().manual_seed(0)).cuda().eval()

    def run() -> None:
        with torch.inference_mode(), mixed_precision(images.device):
            model(images)

    count = sum(p.numel() for p in model.parameters())
    return [f"{count / 1e6:,.1f} M", f"{median_ms(run, 9):.1f}"]


def gaussians_table() -> Table:
    """The rasterizer, and training, on gsplat and on our kernels."""
    title = f"{GAUSSIANS:,} Gaussians, {SIZE} x {SIZE}"
    table = Table("on", "forward and backward, ms", "training, it/s", title=title)
    for device in ("cuda", "cpu"):
        name = "gsplat" if device == "cuda" else f"numba, {numba.get_num_threads()} threads"
        gaussians = [part.detach().to(device).requires_grad_() for part in scattered_gaussians()]
        slopes = [part.to(device) for part in cotangents()]

        def draw(gaussians: list[Tensor] = gaussians, slopes: list[Tensor] = slopes) -> None:
            drawn = rasterize_gaussians(*gaussians, camera())
            torch.autograd.backward(drawn[:3], slopes)

        table.add_row(name, f"{median_ms(draw):.1f}", f"{1000 / median_ms(trained_on(device)):.0f}")
    return table


def trained_on(device: str) -> Callable[[], float]:
    """Steps of training on a device."""
    means, quats, scales, opacities, sh = (
        tensor.detach().to(device) for tensor in scattered_gaussians()
    )
    gaussians = Gaussians(means, quats, scales.log(), opacities.logit(), sh[:, :1], sh[:, 1:])
    graph, generator = SceneGraph(Background(gaussians)), torch.Generator().manual_seed(0)
    strategy = make_strategy("mcmc", GAUSSIANS, 2500)
    trainer = Trainer(graph, 2500, {"background": 5.0}, strategy, lambda *_: 0.0, generator)
    photo = Photo(camera(), 0, torch.rand(SIZE, SIZE, 3, generator=generator).to(device))
    return lambda: trainer.advance(1, photo)


def encoding_table() -> Table:
    """EmerNeRF's hash grid, and a step of its fit, by every path."""
    count, levels = points_on_levels.POINTS, points_on_levels.LEVELS
    title = f"EmerNeRF: {count:,} points on {levels} levels, encoded and differentiated"
    table = Table("on", "3 axes, ms", "4 axes, also by position, ms", "step, ms", title=title)
    table.add_row(f"numba, {torch.get_num_threads()} threads", *encoding_cells("cpu"))
    for name, tcnn in {"torch ops on the GPU": False, "tiny-cuda-nn": True}.items():
        if tcnn and not tcnn_installed():
            continue
        with patch.object(hash_grid, "tcnn_installed", lambda tcnn=tcnn: tcnn):
            table.add_row(name, *encoding_cells("cuda"))
    return table


def encoding_cells(device: str) -> list[str]:
    """Milliseconds of encoding, and of a step of the whole fit."""
    cells = []
    for dims, moving in ((3, False), (4, True)):
        grid = points_on_levels.grid_of(dims).to(device)
        positions = torch.rand(points_on_levels.POINTS, dims, device=device)
        positions.requires_grad_(moving)
        slopes = torch.randn(len(positions), grid.out_features, device=device)
        ms = median_ms(lambda: grid(positions).backward(slopes))  # noqa: B023
        cells.append(f"{ms:.2f}")
    hidden = patch("geoevs.core.networks.best_device", lambda: device)
    with tempfile.TemporaryDirectory() as folder, hidden:
        scene = write_tiny_scene(Path(folder) / "scene")
        seconds = {}
        for steps in (20, 120):
            method = make_method("emernerf", {"iterations": steps})
            views = Views(scene, scene.cameras, method.info.needs)
            start = time.perf_counter()
            method.fit(views, Budget(), Rng(0))
            seconds[steps] = time.perf_counter() - start
    return [*cells, f"{10 * (seconds[120] - seconds[20]):.1f}"]


def main() -> None:
    """Print the tables; without a GPU, say so."""
    if not torch.cuda.is_available():
        sys.exit("this benchmark needs a GPU, and torch sees none")
    console = Console()
    console.print(f"{torch.cuda.get_device_name()}, torch {torch.__version__}; {processor()}")
    tables = [encoding_table, vggt_table, geo_evs_table]
    if importlib.util.find_spec("gsplat"):
        tables.insert(0, gaussians_table)
    for table in tables:
        console.print(table())


if __name__ == "__main__":
    main()
