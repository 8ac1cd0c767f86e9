r"""Poses of parts that agree best with themselves and with the links between parts.

Interpolated own poses :math:`(\hat R, \hat t)`, turns and gaps disagree. The poses that agree with all of them best
minimise, with :math:`Q = \bar Q \exp(\mathrm{turn})` and :math:`a = p_i + \mathrm{gap}`,

.. math::

    \sum_i u_i |R_i - \hat R_i|^2 + v_i |t_i - \hat t_i|^2
        + \sum_l \rho_l |R_j - R_i Q|^2 + \tau_l |R_i a + t_i - R_j p_j - t_j|^2 .

Over matrices R this is a linear system. It is solved for the change from the own poses, which is zero where the
data agree, at the frames. R is then projected to the rotations, and t solved for again, with R given: two linear
systems and a polar decomposition, all smooth. The weights :math:`u, v, \rho, \tau` are one over the mean squared errors
with which each of the curves is predicted by its own neighbouring frames, see `weigh`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import matrices
from mixseq.reconstruction.links import Links, Poses

Float = NDArray[np.float64]


def solve(links: Links, poses: Poses) -> tuple[Float, Float]:
    """Return the rotations ``(N, p, 3, 3)`` and centres ``(N, p, 3)`` that agree best with poses and links.

    At frames, where they all agree, the result is the own poses up to rounding.
    """
    own = matrices(poses.rotations)
    if not len(links):
        return own, poses.translations
    system = _System.of(links, poses)
    rotations = nearest_rotations(own + _turned_part(system.change(own, poses.translations)))
    return rotations, poses.translations + system.shift(rotations, poses.translations)


def velocities(links: Links, poses: Poses, rates: Poses) -> tuple[Float, Float]:
    r"""Return the derivatives of what `solve` returns.

    Parameters
    ----------
    links : Links
        The links.
    poses, rates : Poses
        What `solve` is given, and its derivatives by time (those of rotation vectors for rotations and turns).

    Returns
    -------
    spins : (N, p, 3)
        Angular velocities w in the world's axes, ``dR/dt = [w] R``.
    velocities : (N, p, 3)
        Of the centres.

    Notes
    -----
    With the residuals ``A X`` of the links, which are linear in the poses X, the linear step solves
    :math:`(O + A^T A)(X - \hat X) = -A^T A \hat X`; hence
    :math:`(O + A^T A)(\dot X - \dot{\hat X}) = -A^T A \dot{\hat X} - (\dot A^T A + A^T \dot A) X`.
    The polar decomposition ``M = R S`` turns by w = R u, where
    :math:`(\mathrm{tr}(S) - S)\, u = \mathrm{vee}(R^T \dot M - \dot M^T R)`.
    """
    own = matrices(poses.rotations)
    own_spins = spins(poses.rotations, rates.rotations)
    if not len(links):
        return own_spins, rates.translations
    own_rates = cross_matrices(own_spins) @ own
    system = _System.of(links, poses)
    change = system.change(own, poses.translations)
    moved = own + _turned_part(change)
    rotations = nearest_rotations(moved)
    rate = system.change_rate(own, poses.translations, change, own_rates, rates)
    moved_rate = own_rates + _turned_part(rate)
    stretch = np.swapaxes(rotations, -1, -2) @ moved
    skew = np.swapaxes(rotations, -1, -2) @ moved_rate
    skew = skew - np.swapaxes(skew, -1, -2)
    vee = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    trace = np.trace(stretch, axis1=-2, axis2=-1)[..., None, None]
    body = np.linalg.solve(trace * np.eye(3) - stretch, vee[..., None])
    world = (rotations @ body)[..., 0]
    turning = cross_matrices(world) @ rotations
    shift = system.shift(turning, rates.translations) + system.gap_shift(rotations, rates.gaps)
    return world, rates.translations + shift


def spins(vectors: Float, rates: Float) -> Float:
    r"""Return the angular velocities ``(..., 3)``, in the world's axes, of rotation vectors v that change.

    .. math::

        w = \dot v + \frac{1 - \cos t}{t^2}\, v \times \dot v
            + \frac{t - \sin t}{t^3}\, v \times (v \times \dot v), \qquad t = |v|
    """
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    small = angle < 1e-3  # where the series are exact to rounding
    t = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(t)) / t**2)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120, (t - np.sin(t)) / t**3)
    across = np.cross(vectors, rates)
    return np.asarray(rates + first * across + second * np.cross(vectors, across))


@dataclass(frozen=True, eq=False)
class _System:
    """The least squares problem of N frames; a pose is the 4 x 3 matrix X of the rows of R^T and of t.

    Attributes
    ----------
    links : Links
        The links.
    arms : (N, n, 3)
        Pivots with gaps, a, in part i.
    turns : (N, n, 3)
        Turns of the links.
    rows : (N, 4n, 4p)
        A: the residuals of the links are ``A X``.
    normal : (N, 4p, 4p)
        ``O + A' A``, with the weights O of the own poses.
    """

    links: Links
    arms: Float
    turns: Float
    rows: Float
    normal: Float

    @classmethod
    def of(cls, links: Links, poses: Poses) -> _System:
        arms = links.pivots[:, 0] + poses.gaps
        relative = links.rests @ matrices(poses.turns)
        rows = _rows(links, arms, relative, links.pivots[:, 1])
        own = np.repeat(links.own_weights[:, :1], 4, axis=1)
        own[:, 3] = links.own_weights[:, 1]
        normal = np.swapaxes(rows, 1, 2) @ rows + np.diag(own.reshape(-1))
        return cls(links, arms, poses.turns, rows, normal)

    def change(self, rotations: Float, translations: Float) -> Float:
        """Change ``(N, 4p, 3)`` of poses that lessens the residuals of the links."""
        residuals = self.rows @ _stacked(rotations, translations)
        return np.asarray(np.linalg.solve(self.normal, -np.swapaxes(self.rows, 1, 2) @ residuals))

    def change_rate(
        self, rotations: Float, translations: Float, change: Float, rotation_rates: Float, rates: Poses
    ) -> Float:
        """Derivative ``(N, 4p, 3)`` of `change` by time."""
        poses = _stacked(rotations, translations) + change
        turning = self.links.rests @ cross_matrices(spins(self.turns, rates.turns)) @ matrices(self.turns)
        row_rates = _rows(self.links, rates.gaps, turning, None)
        residual_rates = self.rows @ _stacked(rotation_rates, rates.translations) + row_rates @ poses
        right = np.swapaxes(self.rows, 1, 2) @ residual_rates
        right += np.swapaxes(row_rates, 1, 2) @ (self.rows @ poses)
        return np.asarray(np.linalg.solve(self.normal, -right))

    def shift(self, rotations: Float, translations: Float) -> Float:
        """Shifts ``(N, p, 3)`` of the centres that close the pivots of turned parts best; linear in both."""
        i, j = self.links.parts.T
        open_by = np.einsum("tnij,tnj->tni", rotations[:, i], self.arms) + translations[:, i]
        open_by -= np.einsum("tnij,nj->tni", rotations[:, j], self.links.pivots[:, 1]) + translations[:, j]
        return self._closed(open_by)

    def gap_shift(self, rotations: Float, gap_rates: Float) -> Float:
        """Derivative of `shift` by the gaps."""
        return self._closed(np.einsum("tnij,tnj->tni", rotations[:, self.links.parts[:, 0]], gap_rates))

    def _closed(self, open_by: Float) -> Float:
        links = self.links
        incidence = np.zeros((len(links), len(links.own_weights)))
        each = np.arange(len(links))
        incidence[each, links.parts[:, 0]], incidence[each, links.parts[:, 1]] = 1.0, -1.0
        weighted = incidence.T * links.weights[:, 1]
        system = weighted @ incidence + np.diag(links.own_weights[:, 1])
        return np.asarray(np.linalg.solve(system, -weighted @ open_by))


def _rows(links: Links, arms: Float, relative: Float, ends: Float | None) -> Float:
    """Matrix ``(N, 4n, 4p)`` of the residuals; its derivative if the other ends' coordinates are None."""
    frames, count = arms.shape[:2]
    turn, gap = np.sqrt(links.weights).T
    near, far = np.zeros((2, frames, count, 4, 4))
    near[:, :, 0, :3] = arms * gap[:, None]
    near[:, :, 1:, :3] = -np.swapaxes(relative, -1, -2) * turn[:, None, None]
    if ends is not None:
        near[:, :, 0, 3] = gap
        far[:, :, 0, :3] = -ends * gap[:, None]
        far[:, :, 0, 3] = -gap
        far[:, :, 1:, :3] = np.eye(3) * turn[:, None, None]
    rows = np.zeros((frames, count, 4, len(links.own_weights), 4))
    each = np.arange(count)
    rows[:, each, :, links.parts[:, 0]] = np.swapaxes(near, 0, 1)
    rows[:, each, :, links.parts[:, 1]] = np.swapaxes(far, 0, 1)
    return rows.reshape(frames, 4 * count, -1)


def _stacked(rotations: Float, translations: Float) -> Float:
    """Poses as columns ``(N, 4p, 3)``: the rows of R^T, then t."""
    stacked = np.concatenate([np.swapaxes(rotations, -1, -2), translations[..., None, :]], axis=-2)
    return stacked.reshape(len(stacked), -1, 3)


def _turned_part(stacked: Float) -> Float:
    """Matrices ``(N, p, 3, 3)`` of stacked poses."""
    return np.swapaxes(stacked.reshape(len(stacked), -1, 4, 3)[:, :, :3], -1, -2)


def cross_matrices(vectors: Float) -> Float:
    """Matrices ``(..., 3, 3)`` of the cross product with vectors ``(..., 3)`` from the left."""
    result = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result
