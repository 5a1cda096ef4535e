"""The training loop."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from samira_warp.avatar import Avatar, Gaussians, Rendering, geometry_uv
from samira_warp.data import Frame, PixelCache, TrackedSequence
from samira_warp.evaluate.lpips import Lpips
from samira_warp.evaluate.metrics import psnr
from samira_warp.geometry.camera import Camera
from samira_warp.geometry.mesh import face_areas
from samira_warp.head import FrameParameters
from samira_warp.light import FilteredLight
from samira_warp.support.devices import sent
from samira_warp.support.errors import UserError
from samira_warp.train.begun import CHECKPOINTS_FOLDER
from samira_warp.train.checkpoint import TrainingState, load_training, save_checkpoint
from samira_warp.train.condition_decay import decay_conditions
from samira_warp.train.density import DensityStatistics, control_density, reset_opacity
from samira_warp.train.initialize import initial_spread, spread_out
from samira_warp.train.interrupt import StopRequest
from samira_warp.train.jitter import jittered, tracking_noise
from samira_warp.train.limits import hold_shapes, longest_axes
from samira_warp.train.log import RunLog
from samira_warp.train.losses import TERMS, Known, Target, linear_albedo, loss_weights, total_loss
from samira_warp.train.materials import hold_known
from samira_warp.train.neighbours import neighbourhood
from samira_warp.train.occlusions import FrameOcclusions
from samira_warp.train.optimizer import (
    forget_gaussians,
    make_optimizer,
    replace_gaussians,
    reset_moments,
    set_rates,
)
from samira_warp.train.plan import TrainPlan
from samira_warp.train.ranks import ALONE, Ranks
from samira_warp.train.schedule import LIGHT_FRAMES, learning_rate
from samira_warp.train.shared_light import SharedLight
from samira_warp.train.skin import skin_faces
from samira_warp.train.tracking import TrackedParameters
from samira_warp.train.unseen import guess_unseen, hold_guesses, look

PREFETCH = 8
"""Frames decoded ahead of the step that needs them."""

JITTER_STREAM = 1 << 40
"""Added to the seed of what the network sees, which then has nothing to do with the background's."""

TEST_VIEWS = 4
"""Test frames, evenly spaced, that are looked at on the way; the run's results are over all of them."""

SETTLING_VIEWS = 96
"""Training frames, evenly spaced, that tell what was seen."""


class Trainer:
    """Fits an avatar to a sequence, one frame a step; several ranks take as many steps at once.

    Every random choice is a function of the seed and the step, so a run that goes on from a checkpoint makes
    the same ones.

    Attributes:
        views: (I, 4, 4) the transforms of all frames' cameras, on the device.
        step: Number of steps done by all ranks together.
    """

    def __init__(
        self,
        plan: TrainPlan,
        sequence: TrackedSequence,
        pixels: PixelCache,
        avatar: Avatar,
        *,
        ranks: Ranks = ALONE,
    ) -> None:
        self.plan, self.sequence, self.pixels, self.avatar = plan, sequence, pixels, avatar
        self.ranks = ranks
        self.settings, self.schedule = plan.settings, plan.schedule
        self.weights = loss_weights(plan.settings.ablate)
        self.perceptual: Lpips | None = None
        self.device = torch.device(plan.settings.device)
        self.tracked = TrackedParameters(sequence.batch(sequence.train)).to(self.device)
        views = [frame.camera.world_to_camera for frame in sequence.frames]
        self.views = torch.stack(views).to(self.device)
        moments = [sequence.frames[index].timestep for index in sequence.train]
        noise = tracking_noise(sequence.batch(sequence.train), moments)
        self.noise = {name: values.to(self.device) for name, values in noise.items()}
        self.light = SharedLight(avatar.light)
        self.occlusions = FrameOcclusions(avatar.canonical, avatar.occluder, self.tracked)
        self.known = Known.of(avatar, skin=_held_skin(plan, sequence, self.device))
        spread = initial_spread(avatar.canonical, plan.settings.gaussians)
        self.longest_axes = longest_axes(self.known.face_scales, spread)
        self.optimizer = make_optimizer(avatar, self.tracked)
        self.density = DensityStatistics(len(avatar.gaussians), self.device)
        self.step = self.saved = 0

    def resume(self, checkpoint: Path) -> None:
        """Go on from a checkpoint, whose avatar this trainer was made with."""
        self.step = self.saved = load_training(checkpoint, self._state())

    def run(self, folder: Path, *, record: dict[str, Any]) -> bool:
        """Train to the end of the schedule, with checkpoints and previews in ``folder``.

        Returns:
            False when Ctrl-C ended it early; a checkpoint was saved.
        """
        steps = self.schedule.steps
        writes: RunLog | nullcontext[None] = (
            RunLog(folder, steps=steps, start=self.step) if self.ranks.first else nullcontext()
        )
        with writes as log, StopRequest() as stop:
            while self.step < steps and not self.ranks.any(stop.asked):
                self._prefetch()
                begun = self.step
                rendering, target, terms = self.train_step()
                if log is not None:
                    shows = self._due(self.settings.preview_every, begun)
                    log.add(
                        self.step,
                        terms,
                        frames=self.step - begun,
                        gaussians=len(self.avatar.gaussians),
                        test_psnr=self.test_psnr() if shows else None,
                    )
                    if shows:
                        log.preview(self.step, rendering, target, self.avatar.light.environment())
                if self._due(self.settings.checkpoint_every, begun):
                    self.save(folder, record)
            finished = self.step == steps
            if not finished:
                self.save(folder, record)
        return finished

    def _due(self, every: int, begun: int) -> bool:
        """Whether what is done every so many steps, and at the last, is due after those from ``begun`` on."""
        return self.step // every > begun // every or self.step == self.schedule.steps

    def save(self, folder: Path, record: dict[str, Any]) -> None:
        """Write a checkpoint of the current step, which the first rank does."""
        if self.ranks.first:
            save_checkpoint(folder / CHECKPOINTS_FOLDER, self._state(), record=record)
        self.saved = self.step

    def settle(self) -> None:
        """Guess what no training picture saw (`train.unseen`)."""
        rows = spread_out(range(len(self.sequence.train)), SETTLING_VIEWS)
        indices = [(row, self.sequence.train[row]) for row in rows]
        views = (
            (self.tracked.frame(row, self.sequence.frames[index].parameters), self.camera(index))
            for row, index in indices
        )
        guess_unseen(self.avatar, look(self.avatar, views), self.known.neighbours)
        # what is counted on a GPU may differ in its last bits from rank to rank
        self.ranks.take_firsts(list(self.avatar.gaussians.state_dict().values()))
        forget_gaussians(self.optimizer, self.avatar.gaussians.guessed)

    @torch.no_grad()
    def test_psnr(self) -> float | None:
        """Mean PSNR of a few test frames as the avatar is now, dB; nothing is learned from them.

        None where a picture of them cannot be read, which the results will say once the avatar is kept.
        """
        light, found = self.avatar.light(), []
        for index in spread_out(self.sequence.test, TEST_VIEWS):
            frame = self.sequence.frames[index]
            shadows = self.avatar.settings.visibility
            rendering = self.avatar.render(frame.parameters, self.camera(index), light, shadows=shadows)
            try:
                truth = self.pixels[index].image
            except UserError:
                return None
            found.append(psnr(rendering.image.cpu().clamp(0.0, 1.0), truth))
        return float(torch.stack(found).mean())

    def train_step(self) -> tuple[Rendering, Target, dict[str, torch.Tensor]]:
        """One frame of every rank forward and backward, and what they learned updated.

        Near the end of a run there may be fewer frames than ranks: those that are left without one show the
        last one, which does not count.

        Returns:
            This rank's rendering, what it should be, and the detached loss terms by name, summed over the
            frames of all ranks, with ``mse``, the mean squared error of the image.
        """
        last = max(self.schedule.steps, self.step + 1)
        taken = range(self.step, min(self.step + self.ranks.count, last))
        own = self.step + self.ranks.index
        step, counts = min(own, taken[-1]), own in taken
        if any(map(self.schedule.extended_at, taken)):
            # what was gathered before belongs to a window that had closed
            self.density = DensityStatistics(len(self.avatar.gaussians), self.device)
        if any(map(self.schedule.settles, taken)):
            self.settle()
        row = self._row(step)
        stage_two = "no-two-stage" in self.settings.ablate or self.schedule.in_stage_two(self.step)
        self.avatar.gaussians.normals.requires_grad_(stage_two)
        self.avatar.response_logits.requires_grad_(stage_two)
        if self.avatar.motion.slopes is not None:
            self.avatar.motion.slopes.requires_grad_(stage_two)
        light_learns = any((step + 1) % LIGHT_FRAMES == 0 or step + 1 == last for step in taken)
        light = self.light.light()
        self.avatar.light.requires_grad_(light_learns)
        set_rates(
            self.optimizer,
            step=self.step,
            steps=self.schedule.steps,
            frames=len(taken),
            light_frames=self.light.frames + len(taken),
        )
        frame, target = self._target(row, step)
        camera = self.camera(self.sequence.train[row])
        rendering = self._render(row, step, frame, camera, light, target.background)
        perceptual = (
            self.perceptual if self.schedule.perceptual_on(step) and self._perceptual_turn(step) else None
        )
        terms = total_loss(
            rendering,
            target,
            self.avatar,
            self.weights,
            self.known,
            stage_two=stage_two,
            perceptual=perceptual,
        )
        self.optimizer.zero_grad(set_to_none=True)
        torch.stack(list(terms.values())).sum().backward()
        error = (rendering.image.detach() - target.image).square().mean()
        shown = {**{name: term.detach() for name, term in terms.items()}, "mse": error}
        screened = self._screened(rendering, step)
        if self.ranks.count > 1:
            shown = self._exchange(shown, screened, row, counts=counts, frames=len(taken))
        self.light.listen(frames=len(taken), ranks=self.ranks, counts=counts)
        if light_learns:
            self.light.learn()
        self.density.include(screened)
        hold_known(self.avatar.gaussians, self.known.materials.held)
        hold_guesses(self.avatar.gaussians)
        self.optimizer.step(rows=dict.fromkeys(map(self._row, taken)))
        rate = learning_rate("network", step=self.step, steps=self.schedule.steps)
        decay_conditions(self.avatar.motion, rate=rate, frames=len(taken))
        hold_shapes(self.avatar.gaussians, self.known.face_scales, self.longest_axes)
        self._control_density(taken)
        self.step += len(taken)
        return rendering, target, shown

    def _exchange(
        self,
        shown: dict[str, torch.Tensor],
        screened: DensityStatistics,
        row: int,
        *,
        counts: bool,
        frames: int,
    ) -> dict[str, torch.Tensor]:
        """Make what this rank learned from its frame what all ranks did from theirs.

        Gradients become those of the mean of the frames' objectives, what density control gathers is added
        up, and what was traced of every rank's frame is known to all.

        Args:
            shown: Loss terms by name.
            screened: What density control gathers of this rank's frame; changed in place.
            row: The training frame.
            counts: Whether the frame is counted; else it is here to take part.
            frames: How many are.

        Returns:
            The terms' sums.
        """
        self.ranks.average_gradients(self.optimizer, counts=counts, frames=frames)
        gathered = self.ranks.summed([screened.gradient, screened.views], counts=counts)
        screened.gradient, screened.views = gathered
        scalars = [torch.Size()] * len(TERMS)
        terms = self.ranks.summed_where_any([shown.get(name) for name in TERMS], scalars, counts=counts)
        if self.avatar.settings.visibility:
            for told in self.ranks.gathered(self.occlusions.told(row)):
                self.occlusions.take(told)
        return {name: total for name, total in zip(TERMS, terms, strict=True) if total is not None}

    def _render(
        self,
        row: int,
        step: int,
        frame: Frame,
        camera: Camera,
        light: FilteredLight,
        background: torch.Tensor,
    ) -> Rendering:
        """`Avatar.render` of a training frame under the learned light, with what was traced of it before."""
        avatar = self.avatar
        parameters = self.tracked.frame(row, frame.parameters)
        motion, arrival = avatar.move(parameters, seen=self._seen(parameters, step)), None
        if avatar.settings.visibility:
            occlusion = self.occlusions.of(row, parameters, motion.head)
            arrival = avatar.arrival(occlusion, light, camera)
        gbuffer = avatar.rasterize(motion, camera, arrival=arrival)
        return avatar.shade(motion, gbuffer, camera, light, background=background)

    def _seen(self, parameters: FrameParameters, step: int) -> FrameParameters | None:
        """What the motion network sees of a frame at a step: another draw of the tracker's noise."""
        if not (self.settings.jitter and self.avatar.settings.residual):
            return None
        generator = torch.Generator().manual_seed(self.settings.seed * 1_000_003 + step + JITTER_STREAM)
        return jittered(parameters, self.noise, generator=generator)

    def _state(self) -> TrainingState:
        return TrainingState(
            self.step,
            self.avatar,
            self.tracked,
            self.light,
            self.occlusions,
            self.optimizer,
            self.density,
        )

    def camera(self, index: int) -> Camera:
        """The camera of the sequence's frame at the training resolution, on the device."""
        camera = self.sequence.frames[index].camera.with_longer_side(self.settings.resolution)
        return replace(camera, world_to_camera=self.views[index])

    def _row(self, step: int) -> int:
        """The training frame of a step: a permutation for every epoch, from the seed and the epoch alone."""
        count = len(self.sequence.train)
        epoch, place = divmod(step, count)
        generator = torch.Generator().manual_seed(self.settings.seed * 1_000_003 + epoch)
        return int(torch.randperm(count, generator=generator)[place])

    def _prefetch(self) -> None:
        count, own = self.ranks.count, self.step + self.ranks.index
        ahead = range(own, min(own + PREFETCH * count, self.schedule.steps), count)
        self.pixels.prefetch(self.sequence.train[self._row(step)] for step in ahead)

    def _target(self, row: int, step: int) -> tuple[Frame, Target]:
        index = self.sequence.train[row]
        content = self.pixels[index]
        matted = bool((content.mask < 1.0).any())
        content = content.to(self.device)
        albedo = content.albedo if matted and self.weights.albedo > 0.0 else None
        if albedo is not None:
            albedo = linear_albedo(albedo, color_space=self.settings.color_space)
        mask = content.mask if matted else None
        background = self._background(matted, step)
        image = content.image
        if mask is not None:
            # what white was behind, this colour is behind now
            image = image - (1.0 - mask[..., None]) * (1.0 - background)
        return self.sequence.frames[index], Target(image, mask, albedo, background)

    def _background(self, matted: bool, step: int) -> torch.Tensor:
        """(3,) display values behind the head: another colour every other step, from seed and step alone.

        On one colour, coverage and colour make up for each other along the silhouette; on white, as pictures
        are compared, they are to be exact. White where no matte says what is behind.
        """
        if not matted or step % 2 == 0:
            return torch.ones(3, device=self.device)
        generator = torch.Generator().manual_seed(self.settings.seed * 1_000_003 + step)
        return sent(torch.rand(3, generator=generator), self.device)

    def _perceptual_turn(self, step: int) -> bool:
        """LPIPS is every fourth step's in the cpu preset, and every step's otherwise."""
        return self.settings.preset != "cpu" or step % 4 == 0

    def _screened(self, rendering: Rendering, step: int) -> DensityStatistics:
        """What density control gathers of one frame: nothing outside its window."""
        gathered, screen = (
            DensityStatistics(len(self.avatar.gaussians), self.device),
            rendering.gbuffer.screen,
        )
        if self.schedule.density_window(step) and screen.means2d.grad is not None:
            height, width = rendering.image.shape[:2]
            gathered.add(screen.means2d.grad, screen.visible, width=width, height=height)
        return gathered

    def _control_density(self, taken: range) -> None:
        """Add and remove Gaussians, reset opacity and refresh UV coordinates where the schedule says so.

        Args:
            taken: The steps just taken.
        """
        avatar, canonical = self.avatar, self.avatar.canonical
        if any(map(self.schedule.density_event, taken)):
            generator = torch.Generator().manual_seed(self.settings.seed * 1_000_003 + self.step)
            areas = face_areas(canonical.vertices, canonical.topology.faces)
            change = control_density(
                avatar.gaussians,
                self.density,
                face_scales=self.known.face_scales,
                face_areas=areas,
                cap=self.settings.gaussian_cap,
                generator=generator,
            )
            replace_gaussians(self.optimizer, avatar.gaussians, change.gaussians, change.kept)
            self._refresh_uv(change.gaussians)
            self.ranks.check_equal("Gaussians", len(change.gaussians))
            self.density = DensityStatistics(len(change.gaussians), self.device)
        elif any(map(self.schedule.density_ends, taken)):
            self._refresh_uv(avatar.gaussians)
        if any(map(self.schedule.opacity_reset, taken)):
            reset_opacity(avatar.gaussians)
            reset_moments(self.optimizer, "opacity_logits")

    def _refresh_uv(self, gaussians: Gaussians) -> None:
        """Run Alg. 1 again on the reference mesh."""
        canonical = self.avatar.canonical
        gaussians.uv = geometry_uv(
            gaussians.means.detach(),
            gaussians.faces,
            vertices=canonical.vertices,
            topology=canonical.topology,
            atlas=canonical.atlas,
        )
        self.avatar.set_gaussians(gaussians)
        self.known = self.known._replace(neighbours=neighbourhood(gaussians, canonical))


def _held_skin(plan: TrainPlan, sequence: TrackedSequence, device: torch.device) -> torch.Tensor | None:
    """(F,) faces of skin that is held to what was measured; None where none is."""
    faces = skin_faces(sequence.template)
    return torch.from_numpy(faces).to(device) if plan.skin_prior and faces.any() else None
