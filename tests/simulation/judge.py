"""What must be true of a simulated world: each function reports the promises that are broken."""

from unittest import mock

from simulation import meeting, people
from simulation.installation import ALSO, MOST_PENDING, OWN, RLS, fresh, reorder
from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.edges import LEAK
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.provenance import MEMORY
from valvemap.vocabulary.statuses import Quality

SLACK_S = 1.0  # between two looks at what is shown
CALM_S = 12.0  # after the last fault of a connection, until which its samples come again
NO_TABLES = mock.patch.multiple(MapsAndSurveys, tabulate=mock.DEFAULT, refresh_surveys=mock.DEFAULT)
_CLOSE = 1e-9  # relative to the largest parameter; of a map converted to another unit


def of_shown(world, shown):
    """Nothing older than announced is Good."""
    case, now = world.case, world.time.elapsed
    if case.ports:
        return  # an edge that U closes learns nothing, and is not old
    limit = case.stale_after_s + case.tick_s + SLACK_S + case.sink_s * 4
    if now < world.disturbed + case.tick_s + SLACK_S + case.sink_s * 4:
        return
    for valve, quality in shown.quality.items():
        server = world.server_of[valve]
        if quality != Quality.GOOD or shown.t[valve] not in world.number_of[valve]:
            continue
        taken = server.at[world.number_of[valve][shown.t[valve]]]
        stepped = any(taken <= at <= now for at, _ in server.case.steps)
        if now - taken > limit and not stepped:
            world.violated(f"V{valve} is Good, {now - taken:.2f} s old, {limit:.2f} allowed")


def of_queues(world, live, keeper):
    """Each queue is within its bound."""
    if keeper._rows > world.case.history_rows:
        world.violated(f"{keeper._rows} rows buffered")
    if len(live._publisher) > world.case.valves:
        world.violated(f"{len(live._publisher)} valves queued for publication")
    if live.identification.arrivals.pending().max() > MOST_PENDING:
        world.violated("too many samples wait")
    for server in world.servers:
        if server.longest > server.case.queue:
            world.violated("the server's queue is too long")


def of_start(world, identification, clients, before, said):
    """After a restart: what was acknowledged, or lies before the position, is in the states.

    ``before`` are the states as stored, ``said`` what the service logged in its start.
    """
    behind = set().union(*(client.resumes_behind for client in clients))
    for valve, learnt in enumerate(world.learnt):
        aligned = meeting.learnt_samples(identification, valve)
        if aligned > len(learnt):
            world.violated(f"V{valve} restored {aligned} samples, {len(learnt)} were learnt")
        del learnt[aligned:]
        server = world.server_of[valve]
        if _of_edit(world, identification, valve, before, said):
            server.excuse((valve, k) for k in range(server.taken))
        _of_commands(world, identification, valve)
        excused = _excused(world, valve)
        known = {*learnt, *waiting(world, identification, valve), *excused}
        passed = server.acknowledged[valve] | {k for v, k in behind if v == valve}
        ahead = {k for k in passed - known if not is_overtaken(world, server, k, excused)}
        if ahead:
            world.violated(f"V{valve}: the position is ahead of the state by {sorted(ahead)[:5]}")


def _of_edit(world, identification, valve, before, said):
    """Nothing is learnt under a wrong meaning, nothing is given up that has the right one.

    Returns whether the samples that waited belong to other nodes.
    """
    now, learnt = world.plant[valve], world.learnt[valve]
    rows = [one for one in before if world.known_as(one, (RLS, OWN, LEAK)) == valve]
    newest = max(rows, key=lambda one: one.t, default=None)
    lane = identification._parts.valves.lane(now.name, now.estimator)
    then = None if newest is None else world.meanings[newest.meaning]
    if then is None or not now.keeps_map_of(then):
        world.began[valve] = len(learnt)
        is_other_unit = then is not None and then.flow != now.flow
        world.converted[valve] = is_other_unit and bool(waiting(world, identification, valve))
        world.commands[valve] = []
        if lane.count:
            world.violated(f"V{valve} learns on under another meaning")
        if newest is not None and newest.t and not _is_kept(world, newest):
            world.violated(f"V{valve}: its former state is not kept")
        if newest is not None and newest.t and newest.valve not in said:
            world.violated(f"V{valve}: no word of its former state")
        beside = [one for one in before if world.known_as(one, (MEMORY,)) == valve]
        return any(world.meanings[one.meaning].node != now.node for one in beside)
    if lane.t != newest.t:
        world.violated(f"V{valve} has forgotten what it had learnt")
    if then.flow != now.flow:
        world.converted[valve] = True
        if newest.t and now.name not in said:
            world.violated(f"V{valve}: no word of its conversion")
    return False


def _of_commands(world, identification, valve):
    """Drop the commands that were given behind the restored state; the others are in it."""
    now, n = world.plant[valve], len(world.learnt[valve])
    given = [one for one in world.commands[valve] if one[0] <= n]
    lane = identification._parts.valves.lane(now.name, now.estimator)
    for stop in range(len(given), -1, -1):
        kinds = [kind for _, kind in given[:stop]]
        lam = next((people.FORGETTING[k] for k in kinds[::-1] if k in people.FORGETTING), None)
        frozen = next((k == "freeze" for k in kinds[::-1] if k in ("freeze", "resume")), False)
        is_reset = (n, "reset") in given[:stop]
        if (lane.lam, lane.frozen) == (lam, frozen) and (not is_reset or lane.count == 0):
            if world.all_saved and len(world.commands[valve]) > stop:
                world.violated(f"V{valve}: a command is lost in an orderly stop")
            world.commands[valve] = given[:stop]
            return
        if stop and given[stop - 1][0] < n:
            break
    world.violated(f"V{valve}: lost a command of {given}: {lane.lam}, frozen {lane.frozen}")


def _is_kept(world, row):
    """Whether a state is still in the file, aside or under its name, or waits to be saved there."""
    stored = [one for one, _ in world.states.aside] + world.states.load()
    stored += world.transferred.waiting
    return any(one.state == row.state for one in stored)


def waiting(world, identification, valve):
    """The samples of a valve in its reorder buffer."""
    times = times_waiting(identification._parts.arrivals, valve)
    times += meeting.times_unmet(identification, valve)
    return {world.number_of[valve][t] for t in times if t in world.number_of[valve]}


def times_waiting(arrivals, row):
    """The times of the samples of a row of signals in its reorder buffer."""
    return arrivals.of(row).waiting.slots[0, :, slots.TIME].tolist()


def of_history(world, keeper):
    """History = published values minus counted losses."""
    missing = (world.stored + world.published) - world.past.rows
    if sum(missing.values()) > keeper.lost:
        world.violated(f"history lacks {dict(missing)}, counted {keeper.lost}")
    if invented := world.past.rows - (world.stored + world.published):
        world.violated(f"history holds rows never published: {dict(invented)}")


def of_calm(world, clients):
    """After its last fault, each source delivers again; note which do until an orderly stop."""
    world.delivering = set()
    for client in clients:
        valves = client.server.case.valves
        if delivers(world, client, f"V{valves[0]}"):
            world.delivering.update(valves)


def delivers(world, client, name):
    """Whether samples come; in the calm they must, if nothing else delays them."""
    case = world.case
    last = max((sum(cut) for cut in client.server.cuts), default=0.0)
    last = max(last, client.server.lapsed_at)
    calm_from = max(last, world.disturbed) + CALM_S + 4.0 * (case.sink_s + case.thread_s)
    if world.time.elapsed > calm_from and not client.delivers:
        world.violated(f"nothing comes any more of {name}, though its source is there")
    return client.delivers


def of_counts(world, identification):
    """Every lost sample is one that the source dropped, and is counted."""
    for valve, learnt in enumerate(world.learnt):
        _of_newest(world, identification, valve)
        if not learnt:
            continue
        server = world.server_of[valve]
        unmet = meeting.times_unmet(identification, valve)  # counted behind their gaps already
        known = {*learnt, *(world.number_of[valve][t] for t in unmet)}
        lost = set(range(min(known), max(known))) - known
        excused = _excused(world, valve) | waiting(world, identification, valve)
        dropped = excused - set(learnt)  # before the first learnt one, too: the first may wait
        wrong = {k for k in lost - excused if not is_overtaken(world, server, k, dropped)}
        if wrong:
            world.violated(f"V{valve} lost {sorted(wrong)[:5]}, which the source had")
        if len(set(learnt)) < len(learnt):
            world.violated(f"V{valve} learnt samples twice")
        counters = identification.results.counters(valve)
        world.counts["lost"] += len(lost)
        world.counts["learnt"] += len(learnt)
        counted = counters["gaps"] + counters["missing"]
        is_exact = server.case.numbered and not server.case.restarts
        unmatched = 0
        if len(meeting.rows_behind(world, valve)) > 1:  # counted since the first one that came
            came = (k for k in range(min(known)) if k not in server.excused[valve])
            unmatched = min(known) - next(came, min(known))
        if is_exact and not len(lost) <= counted <= len(lost) + unmatched:
            named = {name: counters[name] for name in COUNTER_NAMES}
            world.violated(f"V{valve} lost {len(lost)}, counted {named}")


def _of_newest(world, identification, valve):
    """All that the source delivered in the end is learnt, but for what waits."""
    learnt, server = world.learnt[valve], world.server_of[valve]
    if valve not in world.delivering or server not in world.all_taken:
        return
    waits = waiting(world, identification, valve)
    rows = meeting.rows_behind(world, valve)
    there = [set(world.learnt[row]) | unmet(world, identification, row) for row in rows]
    stuck = unmet(world, identification, valve) & set.intersection(*there)
    if stuck:
        world.violated(f"V{valve}: {sorted(stuck)[:5]} wait for samples that are there")
    undelivered = {k for v, k in server.undelivered() if v in rows}  # ends what has lapsed
    excused = undelivered | _excused(world, valve)
    first = max(learnt, default=min(server.acknowledged[valve], default=server.taken))
    left = set(range(first + 1, server.subscribed)) - waits - excused
    dropped = excused - set(learnt)
    if left := {k for k in left if not is_overtaken(world, server, k, dropped)}:
        world.violated(f"V{valve} has not learnt {sorted(left)[:5]}, which its source delivered")


def unmet(world, identification, valve):
    """The samples of a valve that wait for those of others."""
    times = meeting.times_unmet(identification, valve)
    return {world.number_of[valve][t] for t in times if t in world.number_of[valve]}


def _excused(world, valve):
    """The samples of a valve that its source may have lost: of an edge, those of its line, too."""
    excused = world.server_of[valve].excused
    return set.union(*(excused[row] for row in meeting.rows_behind(world, valve)))


def is_overtaken(world, server, k, dropped):
    """Whether a late sample lies behind a gap, whose end it need not wait for."""
    wait = reorder(world.case) / server.case.period_s
    messy = server.case.late or server.case.split
    return bool(messy) and any(0 < k - other <= wait for other in dropped)


def of_states(world):
    """The saved states are the bits of one undisturbed life over the same samples.

    A state that was converted to another unit is as close to it as rounding permits.
    """
    with NO_TABLES:  # no state depends on them
        again, restored = fresh(world.case, world.plant), fresh(world.case, world.plant)
        restored.restore(restored.states.review(world.states.load()).checkpoints)
    for valve, one in enumerate(world.plant):
        n = meeting.learnt_samples(restored, valve)
        del world.learnt[valve][n:]
        _of_commands(world, restored, valve)
        if not world.case.meter:
            _relive(world, again, valve, one)
    if world.case.meter:
        meeting.relive_together(world, again)
    names = {one.name: one for one in world.plant}
    stored = {(one.valve, one.estimator): one for one in world.states.load()}
    for own in again.states.checkpoints():
        saved, one = stored.get((own.valve, own.estimator)), names[own.valve]
        if saved is None or own.estimator == ALSO or saved.meaning != own.meaning:
            continue
        if world.converted[one.valve]:
            lanes = [i._parts.valves.lane(own.valve, own.estimator) for i in (again, restored)]
            if not _are_close(*lanes):
                world.violated(f"{own.valve}: its converted state is not that of the new unit")
        elif saved.state != own.state:
            world.violated(f"{own.valve}: the state is not that of an undisturbed life")
        world.note(own.state)


def _relive(world, identification, valve, one):
    """Learn all samples of the present map without a disturbance, with the commands between.

    An estimator that was reset has learnt nothing before it; what else was set remains.
    """
    learnt, commands = world.learnt[valve], world.commands[valve]
    begin = max([world.began[valve], *(n for n, kind in commands if kind == "reset")])
    for end, kind in (*commands, (len(learnt), None)):
        if learnt[begin:end]:
            samples = world.server_of[valve].as_samples(valve, learnt[begin:end], one.gains)
            identification.learn(samples)
        begin = max(begin, end)
        if kind not in (None, "reset"):
            people.command(identification, kind, one)


def _are_close(one, other):
    theta, same = (lane.estimator.parameters(lane.state)[0] for lane in (one, other))
    known = theta == theta  # noqa: PLR0124 - not NaN
    scale = abs(theta[known]).max(initial=0.0)
    return one.count == other.count and (
        abs(theta - same)[known].max(initial=0.0) <= _CLOSE * scale
    )
