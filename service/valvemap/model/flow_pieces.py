"""The form of a map of `FlowMap`, for certified errors of its tables.

At one temperature, U ≥ 0 and Δp ≥ 0, with p(U) the place on the map (`kernels.flow_look`),

    Q = max(g(p(U), s), least)·G(s) + k·s²,   G(s) = gain + Σ w_i·b_i/(s + b_i)

g is quadratic between its knots, p is linear. So Q is the larger of two parts; only G is no
polynomial, and its poles are at s = -b_i.
"""

import numpy as np

from valvemap.model.flow_arrays import Both, bare_memory, new_room
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import flow_drift, flow_fit, flow_look, flow_memory
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.map_forms import DEGREES, MapForm, Part, left_over, nothing_left
from valvemap.model.samples import Floats, Singles


def form(state: FlowMapState, both: Both, T: float) -> MapForm | None:
    """Return the form; None before the first fit, and where G is not positive."""
    if not state.counters[flow_memory.FITTED]:
        return None
    axis_U, axis_s = both
    low, end, top = axis_U.breaks[0], axis_U.breaks[-1], axis_s.breaks[-1]
    edge = float(state.now[0, 0, flow_drift.EDGE])
    rate = 1.0 + edge / max(abs(end), 1e-9)
    least = float(state.scalars[flow_fit.LEAST])
    floor = np.full_like(state.theta, least)
    parts = _part(state, both, state.theta, T), _part(state, both, floor, T)
    s = np.linspace(0.0, top, 401)
    nothing = 0.0 * state.theta
    G, of_nothing = (_part(state, both, x, T)(0.0 * s, s) for x in (nothing + 1.0, nothing))
    if not (rate > 0.0 and (G - of_nothing > 0.0).all()):
        return None
    poles = _poles(state, top, T)
    size = max(float(np.abs(state.theta).max()), abs(least))

    def remainder(edges_U: Floats, edges_s: Floats) -> Floats:
        def most(middle: Floats, across: Floats, up: Floats) -> Floats:
            """Of (max g)·Σ w·b/(s + b): a quadratic grows by ρ² at most up to the ellipse."""
            total = np.zeros_like(middle)
            for weight, b in poles:
                room = middle - across + b
                total += np.where(room > 0.0, weight * b / np.where(room > 0.0, room, 1.0), np.inf)
            return np.asarray(total * size * (across + up) / (across - up))

        if not poles:
            return nothing_left(edges_U, edges_s)
        along = left_over(edges_s, DEGREES[1], most)
        return np.broadcast_to(along, (len(edges_U) - 1, len(along)))

    knots_U = np.append((axis_U.breaks + edge) / rate, [low, end])
    return MapForm(knots_U, axis_s.breaks, parts, remainder)


def _part(state: FlowMapState, both: Both, theta: Singles, T: float) -> Part:
    """The map of coefficients ``theta`` without its lower bound."""
    unbounded = state.scalars.copy()
    unbounded[flow_fit.LEAST] = -np.inf
    memory = bare_memory(state)._replace(theta=theta, scalars=unbounded)

    def flow(U: Floats, s: Floats) -> Floats:
        Q, std = np.empty((2, U.size))
        room = new_room()
        flow_look.evaluate(*both, memory, U, s**2, np.full(U.size, T), Q, std, room)
        return Q

    return flow


def _poles(state: FlowMapState, top: float, T: float) -> list[tuple[float, float]]:
    """Weight and distance from s = 0 of the poles of G that are there."""
    colder = float(state.scalars[flow_fit.FIRST_T]) - T
    x = float(np.clip(rules.THINNING * colder, -2.0, 2.0)) if np.isfinite(colder) else 0.0
    gain = 1.0 + state.now[0, 0, flow_drift.GAIN]
    rates = gain * state.now[0, 0, flow_drift.LEVELS : flow_drift.RATES]
    weights = x * rates[1] + x * x * (1.0 + rules.FLATTENS * x) * rates[2], x * rates[3]
    places = rules.LAMINAR * top, rules.CREEPING * top
    found = zip(weights, places, strict=True)
    return [(rules.STRONG * abs(float(weight)), b) for weight, b in found if weight != 0.0]
