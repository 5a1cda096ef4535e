"""Least squares over a whole film: a band of frames that know their neighbours, and a border, the subject.

A frame's unknowns meet those of frames near in time by smoothness alone, and the subject's everywhere: the
matrix of the normal equations is banded but for a border, and is solved by banded Cholesky and the border's
Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from threadpoolctl import threadpool_limits
from torch import Tensor

REACH = 2
"""Frames to either side that smoothness ties a frame to: second differences."""


@dataclass(eq=False)
class NormalEquations:
    """J^T W J and J^T W r of all that was added, float64.

    Attributes:
        frames: (N, P, P).
        frames_gradient: (N, P).
        border: (N, P, Q).
        subject: (Q, Q).
        subject_gradient: (Q,).
        smoothness: (P,) weights of the squared second differences of the frames' parameters.
        with_subject: Whether the subject is solved for, too.
    """

    frames: Tensor
    frames_gradient: Tensor
    border: Tensor
    subject: Tensor
    subject_gradient: Tensor
    smoothness: Tensor
    with_subject: bool

    @classmethod
    def zero(
        cls, frames: int, frame_size: int, subject_size: int, *, with_subject: bool = True
    ) -> NormalEquations:
        """Nothing added yet."""

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(shape, dtype=torch.float64)

        return cls(
            frames=zeros(frames, frame_size, frame_size),
            frames_gradient=zeros(frames, frame_size),
            border=zeros(frames, frame_size, subject_size),
            subject=zeros(subject_size, subject_size),
            subject_gradient=zeros(subject_size),
            smoothness=zeros(frame_size),
            with_subject=with_subject,
        )

    def add(
        self, rows: slice, by_frame: Tensor, by_subject: Tensor | None, residuals: Tensor, weights: Tensor
    ) -> None:
        """Add weighted squares of residuals of some frames.

        Args:
            rows: n of the frames.
            by_frame: (n, R, P) derivatives of the residuals.
            by_subject: (n, R, Q), None where the subject is not solved for.
            residuals: (n, R).
            weights: (n, R) of their squares.
        """
        weighted = by_frame * weights[..., None]
        self.frames[rows] += (weighted.mT @ by_frame).double()
        self.frames_gradient[rows] += (weighted.mT @ residuals[..., None])[..., 0].double()
        if by_subject is not None:
            self.border[rows] += (weighted.mT @ by_subject).double()
            flat = by_subject.flatten(0, 1)
            scaled = flat * weights.flatten()[:, None]
            self.subject += (scaled.T @ flat).double()
            self.subject_gradient += (scaled.T @ residuals.flatten()).double()

    def add_frame_prior(self, values: Tensor, weights: Tensor) -> None:
        """Add weighted squares of (N, P) values that are the frames' parameters less constants."""
        self.frames.diagonal(dim1=1, dim2=2).add_(weights)
        self.frames_gradient += weights * values

    def add_subject_prior(self, values: Tensor, weights: Tensor) -> None:
        """Add weighted squares of (Q,) values that are the subject's parameters less constants."""
        self.subject.diagonal().add_(weights)
        self.subject_gradient += weights * values

    def add_smoothness(self, values: Tensor, weights: Tensor) -> None:
        """Add weighted squares of second differences of the (N, P) parameters.

        Args:
            values: The parameters as they are.
            weights: (P,).
        """
        self.smoothness += weights
        if len(values) > REACH:
            bends = values[2:] - 2 * values[1:-1] + values[:-2]
            pull = weights * bends
            self.frames_gradient[:-2] += pull
            self.frames_gradient[1:-1] -= 2 * pull
            self.frames_gradient[2:] += pull

    def solve(self, *, damping: float) -> tuple[Tensor, Tensor]:
        """The damped step to the minimum: (N, P) of the frames, (Q,) of the subject.

        Args:
            damping: Share of the diagonal that is added to it (Levenberg and Marquardt).
        """
        count, size = self.frames_gradient.shape
        band = self._band(damping)
        with threadpool_limits(1, user_api="blas"):  # its threads cost more than they bring in narrow bands
            factor = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
        gradient = self.frames_gradient.reshape(count * size).numpy()
        if not self.with_subject:
            frames = -cho_solve_banded((factor, True), gradient, check_finite=False)
            return torch.from_numpy(frames).view(count, size), torch.zeros_like(self.subject_gradient)
        border = self.border.reshape(count * size, -1).numpy()
        solved = cho_solve_banded(
            (factor, True), np.concatenate([border, gradient[:, None]], axis=1), check_finite=False
        )
        subject = self.subject.numpy() + damping * np.diag(np.diag(self.subject.numpy()))
        schur = subject - border.T @ solved[:, :-1]
        right = self.subject_gradient.numpy() - border.T @ solved[:, -1]
        step = -cho_solve(cho_factor(schur, lower=True), right)
        frames = -(solved[:, -1] + solved[:, :-1] @ step)
        return torch.from_numpy(frames).view(count, size), torch.from_numpy(step)

    def _band(self, damping: float) -> np.ndarray:
        """(1 + REACH P, N P) lower band of the frames' matrix, the diagonal first."""
        count, size = self.frames_gradient.shape
        band = np.zeros((1 + REACH * size, count, size))
        frames = self.frames.numpy()
        for below in range(size):
            band[below, :, : size - below] = np.diagonal(frames, offset=-below, axis1=1, axis2=2)
        band[0] *= 1.0 + damping
        weights = self.smoothness.numpy()
        if count > REACH:
            bend = np.zeros((count, 3))  # of D^T D: the diagonal and the two beside it
            for offset, factor in enumerate((1.0, -2.0, 1.0)):
                for other, second in enumerate((1.0, -2.0, 1.0)[offset:], offset):
                    bend[offset : count - 2 + offset, other - offset] += factor * second
            for apart in range(REACH + 1):
                band[apart * size] += bend[:, apart, None] * weights
        return band.reshape(1 + REACH * size, count * size)
