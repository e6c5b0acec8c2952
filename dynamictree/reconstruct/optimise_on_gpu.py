"""Optimisation of Gaussians with gsplat (Ye et al. 2025, extra `gpu`), the CUDA counterpart of `optimise`.

Densification is gsplat's MCMC (Kheradmand et al. 2024), and the number of steps is that of Kerbl et al. 2023: ten per
step of the CPU's schedule. It has been run with a stand-in for gsplat only (docs/limits.md).
"""

from collections.abc import Callable
from typing import Any

import gsplat
import numpy as np
import torch
from jaxtyping import Float

from dynamictree.gaussian.cuda import world_to_camera_matrix
from dynamictree.gaussian.rasterize_kernel import NEAR_M, PIXEL_PX2
from dynamictree.reconstruct.optimise import Schedule, SplatTask, Target, downscaled
from dynamictree.reconstruct.picture_loss import SSIM_SHARE, WINDOW, psnr
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import COLOR, LOG_SCALE, LOGIT, MEAN, QUATERNION, REST

STEPS = 10
"""Steps of gsplat per step of the schedule."""
_RATES = {"means": 1.6e-4, "quats": 1e-3, "scales": 5e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 1.25e-4}
"""Learning rates of Kerbl et al. 2023; that of means is multiplied by the extent and falls to a hundredth."""
_COLUMNS = {"means": MEAN, "quats": QUATERNION, "scales": LOG_SCALE, "opacities": slice(LOGIT, LOGIT + 1)}

Picture = Float[torch.Tensor, "3 H W"]


def optimise_on_gpu(
    state: SplatState,
    task: SplatTask,
    schedule: Schedule,
    on_step: Callable[[SplatState], None] = lambda state: None,
    *,
    device: str = "cuda",
) -> None:
    """Optimise Gaussians in place like `optimise.optimise`, with the same arguments.

    `on_step` always gets the current state. A saved state continues with Adam's moments at zero.
    """
    regularity = 0.01  # weights of mean opacity and scale in the loss, Kheradmand et al. 2024
    torch.manual_seed(state.step)
    params = _params(state, device)
    optimizers = {
        name: torch.optim.Adam([value], lr=_RATES[name] * (task.extent if name == "means" else 1.0), eps=1e-15)
        for name, value in params.items()
    }
    fall = torch.optim.lr_scheduler.ExponentialLR(optimizers["means"], 0.01 ** (1 / (STEPS * schedule.num_steps)))
    strategy = gsplat.MCMCStrategy(
        cap_max=schedule.rules.max_gaussians,
        refine_start_iter=int(STEPS * schedule.num_steps * schedule.densify[0]),
        refine_stop_iter=int(STEPS * schedule.num_steps * schedule.densify[1]),
        min_opacity=schedule.rules.min_opacity,
    )
    strategy.check_sanity(params, optimizers)
    running = strategy.initialize_state()
    targets = [downscaled(target, schedule.side_px) for target in task.targets]
    held_out = [downscaled(target, schedule.side_px) for target in task.held_out]
    while state.step < schedule.num_steps:
        on_step(state)
        degree = min(schedule.sh_degree, state.step // schedule.degree_every)
        for part in range(STEPS):
            step = STEPS * state.step + part
            turn, place = divmod(step, len(targets))
            target = targets[int(np.random.default_rng([2, turn]).permutation(len(targets))[place])]
            picture, wanted, information = _render(params, target, degree)
            loss = _loss(picture, wanted)
            loss = loss + regularity * (params["opacities"].sigmoid().mean() + params["scales"].exp().mean())
            loss.backward()
            for optimizer in optimizers.values():
                optimizer.step()
                optimizer.zero_grad(set_to_none=True)
            rate = optimizers["means"].param_groups[0]["lr"]
            strategy.step_post_backward(params, optimizers, running, step, information, lr=rate)
            fall.step()
        state.step += 1
        state.keep(np.arange(0), _table(params))
        if held_out and state.step % schedule.check_every == 0:
            state.checks = np.concatenate(
                [state.checks, [[state.step, len(state.table), _mean_psnr(params, held_out, degree)]]]
            )


def _params(state: SplatState, device: str) -> torch.nn.ParameterDict:
    table = torch.from_numpy(state.table).to(device)
    harmonics = table[:, COLOR.start :].reshape(len(table), -1, 3)
    values = {name: table[:, columns] for name, columns in _COLUMNS.items()}
    values["opacities"] = values["opacities"][:, 0]
    values |= {"sh0": harmonics[:, :1], "shN": harmonics[:, 1:]}
    return torch.nn.ParameterDict(
        {name: torch.nn.Parameter(value.clone().contiguous()) for name, value in values.items()}
    )


def _table(params: torch.nn.ParameterDict) -> Float[np.ndarray, "G P"]:
    with torch.no_grad():
        quaternions = torch.nn.functional.normalize(params["quats"], dim=1)
        geometry = [params["means"], quaternions, params["scales"], params["opacities"][:, None]]
        colors = torch.cat([params["sh0"], params["shN"]], dim=1).flatten(start_dim=1)
        table: Float[np.ndarray, "G P"] = torch.cat([*geometry, colors], dim=1).cpu().numpy()
    assert table.shape[1] >= REST
    return table


def _render(params: torch.nn.ParameterDict, target: Target, degree: int) -> tuple[Picture, Picture, dict[str, Any]]:
    """Render a target; return the picture and the photo, both on one random colour if the photo has a mask."""
    device, (height, width) = params["means"].device, target.photo.shape[:2]
    seen, alpha, information = gsplat.rasterization(
        means=params["means"],
        quats=params["quats"],
        scales=params["scales"].exp(),
        opacities=params["opacities"].sigmoid(),
        colors=torch.cat([params["sh0"], params["shN"]], dim=1),
        viewmats=torch.tensor(world_to_camera_matrix(target.camera), dtype=torch.float32, device=device)[None],
        Ks=torch.tensor(target.camera.intrinsics_px(width, height), dtype=torch.float32, device=device)[None],
        width=width,
        height=height,
        near_plane=float(NEAR_M),
        eps2d=PIXEL_PX2,
        sh_degree=degree,
        packed=False,
        rasterize_mode="antialiased",
    )
    photo, picture = torch.from_numpy(target.photo).to(device), seen[0]
    if target.alpha is not None:
        cover, behind = torch.from_numpy(target.alpha).to(device)[..., None], torch.rand(3, device=device)
        photo, picture = photo * cover + behind * (1 - cover), picture + behind * (1 - alpha[0])
    return picture.permute(2, 0, 1), photo.permute(2, 0, 1), information


def _loss(picture: Picture, photo: Picture) -> Float[torch.Tensor, ""]:
    """Compute `picture_loss.picture_loss` in torch, for autograd."""
    line = torch.from_numpy(WINDOW).to(picture.device)
    window = torch.outer(line, line).expand(15, 1, -1, -1)
    maps = torch.cat([picture, photo, picture * picture, photo * photo, picture * photo])[None]
    means = torch.nn.functional.conv2d(maps, window, padding=len(WINDOW) // 2, groups=15)[0]
    mx, my, xx, yy, xy = means.reshape(5, *picture.shape)
    similar = (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4)
    similar = similar / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4))
    distance = (picture - photo).abs().mean()
    loss: Float[torch.Tensor, ""] = (1 - SSIM_SHARE) * distance + SSIM_SHARE * (1 - similar.mean())
    return loss


def _mean_psnr(params: torch.nn.ParameterDict, targets: list[Target], degree: int) -> float:
    with torch.no_grad():
        pairs = [_render(params, target, degree)[:2] for target in targets]
    return float(np.mean([psnr(a.clamp(0, 1).cpu().numpy(), b.cpu().numpy()) for a, b in pairs]))
