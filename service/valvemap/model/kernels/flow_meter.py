"""What the meter shows: the flow of several moments, by the map behind the operators."""

import math

from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_basis import Axis, surface
from valvemap.model.samples import Floats, Singles


@inner
def metered(
    axis_U: Axis, axis_s: Axis, theta: Singles, least: float, recent: Singles, newest: int,
    known: int, ahead: int, path: Floats, work: Floats, out: Floats,
) -> bool:  # fmt: skip
    """Means over what the meter shows now; False: not enough is known.

    ``newest`` is the row of the sample, ``known`` the number of rows up to it, ``ahead`` of those
    behind it. ``out[:6]`` becomes the mean of spool and root; of the flow, less that at the mean
    place; of the squared difference; the variances of spool and root. Flows are those of the map
    ``theta``, see `flow_path.forward`, at the mean places of parts of equal weight. ``out[6:]``
    grows by the standard deviations of spool and root on the way between two rows.
    """
    out[:6] = 0.0
    total, age, row = 0.0, 0.0, newest
    part, u, r = 0.0, 0.0, 0.0
    back, dead, share, is_known = paths.ago(recent, newest, known, path[paths.DEAD_Q])
    if not is_known:
        return False
    if share > 0.0:
        _on_the_way(axis_s, recent, newest, known, ahead, back, share, path, out)
    horizon = dead + path[paths.AVERAGE] + rules.LAGS_LEFT * path[paths.LAG_Q]
    for k in range(known):
        step = float(recent[row, paths.STEP])
        weight = _share(age + step - dead, path) - _share(age - dead, path)
        spool, root = (
            float(recent[row, paths.SPOOL]),
            _root(axis_s, recent, row, known - k, ahead + k, path),
        )
        is_last = step >= rules.GAP or k == known - 1
        if share > 0.0 and weight > 0.0 and not is_last:
            older = paths.row_before(recent, row, 1)
            spool += share * (float(recent[older, paths.SPOOL]) - spool)
            behind = _root(axis_s, recent, older, known - k - 1, ahead + k + 1, path)
            root = paths.root_between(root, behind, share)
        total += weight
        out[0] += weight * spool
        out[1] += weight * root
        out[4] += weight * spool * spool
        out[5] += weight * root * root
        part, u, r = part + weight, u + weight * spool, r + weight * root
        age += step
        is_last = is_last or age > horizon
        if part >= 1.0 / rules.POINTS_SHOWN or (is_last and part > 0.0):
            flow = _flow(axis_U, axis_s, theta, least, u / part, r / part, work)
            out[2] += part * flow
            out[3] += part * flow * flow
            part, u, r = 0.0, 0.0, 0.0
        if is_last:
            break
        row = paths.row_before(recent, row, 1)
    if total < rules.ENOUGH_SHOWN:
        return False
    for place in range(6):
        out[place] /= total
    out[3] = max(out[3] - out[2] ** 2, 0.0)
    out[4], out[5] = out[4] - out[0] ** 2, out[5] - out[1] ** 2
    out[2] -= _flow(axis_U, axis_s, theta, least, out[0], out[1], work)
    return True


@inner
def _on_the_way(
    axis_s: Axis, recent: Singles, newest: int, known: int, ahead: int, back: int, share: float,
    path: Floats, out: Floats,
) -> None:  # fmt: skip
    """Add the standard deviations of spool and root between two rows to ``out[6:]``.

    A straight line joins them. One that bends at either row may bend beside it as well, by as much
    as w·(1 - w) of both second differences, but goes one way.
    """
    newer = paths.row_before(recent, newest, back)
    older = paths.row_before(recent, newer, 1)
    after = paths.row_before(recent, newest, back - 1) if back > 0 else newer
    before = paths.row_before(recent, older, 1) if back + 2 < known else older
    width = share * (1.0 - share)
    u, v = float(recent[newer, paths.SPOOL]), float(recent[older, paths.SPOOL])
    bend = other = abs(u - 2.0 * v + float(recent[before, paths.SPOOL]))
    if back > 0:
        other = abs(float(recent[after, paths.SPOOL]) - 2.0 * u + v)
    out[6] += min(width * (bend + other), paths.one_way(v, u, share))
    u = _root(axis_s, recent, newer, known - back, ahead + back, path)
    v = _root(axis_s, recent, older, known - back - 1, ahead + back + 1, path)
    x = _root(axis_s, recent, before, known - back - 2, ahead + back + 2, path)
    bend = other = abs(u - 2.0 * v + x)
    if back > 0:
        x = _root(axis_s, recent, after, known - back + 1, ahead + back - 1, path)
        other = abs(x - 2.0 * u + v)
    out[7] += min(width * (bend + other), paths.one_way(v, u, share))


@inner
def _root(
    axis_s: Axis, recent: Singles, row: int, known: int, ahead: int, path: Floats
) -> float:  # fmt: skip
    """Root of the Δp that counts at a row, within the axis."""
    dp, _ = paths.between(recent, row, known, ahead, paths.LEFT_DP, path[paths.HELD_P])
    p1, _ = paths.between(recent, row, known, ahead, paths.LEFT_P1, path[paths.HELD_P])
    return float(min(max(paths.effective(dp, p1, path), axis_s.breaks[0]), axis_s.breaks[-1]))


@inner
def _flow(
    axis_U: Axis, axis_s: Axis, theta: Singles, least: float, u: float, s: float, work: Floats
) -> float:
    flow = surface(axis_U, axis_s, theta, u, s, work)
    return paths.forward(flow, 0 if u >= 0.0 else 1, s, least)


@inner
def _share(x: float, path: Floats) -> float:
    """Of what the meter shows, the share that is younger than ``x`` s before the dead time."""
    w, tau = path[paths.AVERAGE], path[paths.LAG_Q]
    if x <= 0.0:
        return 0.0
    if tau <= 0.0:
        return min(x / w, 1.0) if w > 0.0 else 1.0
    if w <= 0.0:
        return 1.0 - math.exp(-x / tau)
    y = min(x, w)  # ∫ of the box's share behind the lag
    share = (y - tau * (1.0 - math.exp(-y / tau))) / w
    if x > w:
        inside = tau / w * (math.exp(-(x - w) / tau) - math.exp(-x / tau))
        share = 1.0 - inside
    return float(share)
