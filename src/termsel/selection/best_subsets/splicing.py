"""The best subsets that differ from one by a column, all told from one factorisation.

Descents look at every such change of a subset. One factorisation of the subset shows the scores of
all of them, as the sacrifices of splicing do (Zhu et al. 2020, PNAS 117(52)), but exactly and for
exchanges as well: residual sums of squares, and errors of check points. So only the best of each
size is scored as every subset is.
"""

from __future__ import annotations

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, IntArray
from termsel.selection.best_subsets.columns.kernels import LINEAR, RATIONAL, RSS
from termsel.selection.best_subsets.columns.system import BITS, Masks, SubtreeNode
from termsel.selection.best_subsets.score_systems import ScoreSystems

TRIED = 16
"""Best changes of a size that are scored, where poles or parents rule some out."""

ROUNDING = 1e-9
"""A subset reached in another order differs by less."""


def find_best_by_splicing(systems: ScoreSystems, mask: int, best: FloatArray, masks: Masks,
                          infeasible: set[bytes]) -> tuple[FloatArray, Masks] | None:
    """Return the best score and mask of each size, (k + 1,) each, after all changes of a subset.

    Best and masks are those so far. Infeasible subsets that were scored before are not scored
    again; further ones are added. Returns None where columns of the subset are dependent, or where
    TRIED changes of a size are infeasible: then all of them have to be walked.
    """
    used = systems.everything.used
    inside = (BITS[systems.everything.candidates] & np.uint64(mask)) != 0
    members = systems.everything.candidates[inside]
    outsiders = systems.everything.candidates[~inside]
    scores = _scores_after_changes(systems, used, members, outsiders)
    if scores is None:
        return None
    if len(members) >= systems.everything.room:
        scores[0, 1:] = np.inf
    row, column = np.indices(scores.shape)
    sizes = len(used) + len(members) + (column > 0) - (row > 0)
    # Of each size the change with the least score first; the walk then tells whether it is
    # feasible, which the scores do not.
    for size in np.unique(sizes):
        improving = np.flatnonzero((sizes == size) & (scores < (1.0 - ROUNDING) * best[size]))
        tried = 0
        for change in improving[np.argsort(scores.flat[improving], kind="stable")]:
            dropped, added = np.unravel_index(change, scores.shape)
            subset = np.concatenate([used, members[np.arange(1, len(members) + 1) != dropped],
                                     outsiders[np.arange(1, len(outsiders) + 1) == added]])
            key = np.sort(subset).tobytes()
            if key in infeasible:
                continue
            if tried == TRIED:
                return None
            tried += 1
            result = systems.walk(SubtreeNode(subset, outsiders[:0], 0), best, masks)
            if result.best[size] < best[size]:
                best = result.best
                masks = result.masks
                break
            infeasible.add(key)
    return best, masks


def tells_changes(systems: ScoreSystems) -> bool:
    """Return whether `find_best_by_splicing` knows the score.

    It does of residuals, and of check errors if there is one target.
    """
    one_target = systems.systems[0].control.shape[1] == systems.k + 1
    return systems.kind == RSS or (systems.kind in (LINEAR, RATIONAL) and one_target
                                   and len(systems.systems) == 1)


def _scores_after_changes(systems: ScoreSystems, used: IntArray, members: IntArray,
                          outsiders: IntArray) -> FloatArray | None:
    """Return the scores (1 + members, 1 + outsiders) after each change.

    Row 0 keeps all members, the others drop one each; column 0 adds none, so that [0, 0] is the
    subset itself. Infinite where columns would be dependent; None if those of the subset are. With
    the residuals v of a column and t of the target, adding the column takes the share s = v't / v'v
    of it off t. A dropped member gives back what its dual vector u, of length 1, has of them: t
    grows by (u'b) u, and v by (u'a) u.
    """
    rows = systems.systems[0]
    subset = np.concatenate([members, used])
    target = rows.control[:, systems.k:]
    columns = rows.control[:, outsiders]
    Q, R = np.linalg.qr(rows.control[:, subset])
    if len(R) < len(subset) or (np.abs(np.diag(R)) <= TOLERANCE * rows.lengths[subset]).any():
        return None
    inverse = np.linalg.inv(R)
    # The columns of Q R^-T: each is orthogonal to all of the subset but its own.
    dual = Q @ inverse.T[:, :len(members)]
    dual_lengths = np.linalg.norm(dual, axis=0)
    dual /= dual_lengths
    # The letters are those of the docstring; row 0 of `u_b` and `u_a` stands for no member dropped.
    t = target - Q @ (Q.T @ target)
    v = columns - Q @ (Q.T @ columns)
    u_b = np.vstack([np.zeros(target.shape[1]), dual.T @ target])
    u_a = np.vstack([np.zeros(len(outsiders)), dual.T @ columns])
    lengths = (v**2).sum(axis=0) + u_a**2
    products = v.T @ t + u_a[:, :, None] * u_b[:, None, :]
    independent = lengths > (TOLERANCE * rows.lengths[outsiders]) ** 2
    if systems.kind == RSS:
        before = (t**2).sum() + (u_b**2).sum(axis=1)
        gains = np.divide((products**2).sum(axis=2), lengths, where=independent,
                          out=np.zeros(lengths.shape))
        after = np.where(independent, before[:, None] - gains, np.inf)
        return np.column_stack([before, after])
    # The same in the rows of the score: what the columns leave there, and the dual vectors.
    later = np.append(outsiders, systems.k)
    solutions = inverse @ (Q.T @ rows.control[:, later])
    remainders = rows.extra[:, later] - rows.extra[:, subset] @ solutions
    z = rows.extra[:, subset] @ (inverse @ inverse.T[:, :len(members)]) / dual_lengths
    z = np.vstack([np.zeros(len(rows.extra)), z.T])
    without = remainders[:, -1] + u_b * z
    shares = np.divide(products[:, :, 0], lengths, where=independent, out=np.zeros(lengths.shape))
    added = remainders[:, :-1].T[None] + u_a[:, :, None] * z[:, None]
    errors = np.concatenate([without[:, None], without[:, None] - shares[:, :, None] * added],
                            axis=1)
    scores = systems.score_of_errors(errors)
    scores[:, 1:][~independent] = np.inf
    return scores
