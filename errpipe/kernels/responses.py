"""Causal responses of one signal over many runs: lag, switch, direction, approach, first value.

`run` holds an integer per row; a state restarts wherever it changes. Times in s, lengths in mm.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel


@kernel
def first_value(run, u):
    """Value of u at the first finite row of each run, held over the run; NaN before it."""
    y = np.empty(u.size)
    held = np.nan
    for i in range(u.size):
        if i == 0 or run[i] != run[i - 1]:
            held = np.nan
        if np.isnan(held):
            held = u[i]
        y[i] = held
    return y


@kernel
def lag(run, t, u, tau_up, tau_down, start_at_input):
    """First-order lag, exact for u held between rows; a missing u holds the one before it."""
    y = np.empty(u.size)
    state = 0.0
    held = np.nan
    for i in range(u.size):
        if i == 0 or run[i] != run[i - 1]:
            held = u[i]
            state = u[i] if start_at_input else 0.0
        else:
            if np.isnan(held):
                if start_at_input:
                    state = u[i]
            else:
                tau = tau_up if held >= state else tau_down
                state = held + (state - held) * np.exp(-(t[i] - t[i - 1]) / tau)
            if not np.isnan(u[i]):
                held = u[i]
        y[i] = state
    return y


@kernel
def lag_straight(run, t, u, tau_up, tau_down, start_at_input):
    """First-order lag, exact for u that runs straight from row to row; u must not miss."""
    y = np.empty(u.size)
    state = 0.0
    for i in range(u.size):
        if i == 0 or run[i] != run[i - 1]:
            state = u[i] if start_at_input else 0.0
        elif t[i] > t[i - 1]:
            dt = t[i] - t[i - 1]
            tau = tau_up if 0.5 * (u[i] + u[i - 1]) >= state else tau_down
            behind = (u[i] - u[i - 1]) / dt * tau
            state = u[i] - behind + (state - u[i - 1] + behind) * np.exp(-dt / tau)
        y[i] = state
    return y


@kernel
def lag_paused(run, t, u, tau_up, tau_down, start_at_input, pause, usual):
    """First-order lag of what rests at 0 while nothing is made; u must not miss.

    u[i] is held over the step to row i, which is the part just made; of a step longer than `pause` only the last
    `usual` seconds, the time before it at rest.
    """
    y = np.empty(u.size)
    state = 0.0
    for i in range(u.size):
        if i == 0 or run[i] != run[i - 1]:
            state = u[i] if start_at_input else 0.0
        else:
            busy = t[i] - t[i - 1]
            if busy > pause:
                state *= np.exp(-(busy - usual) / tau_down)
                busy = usual
            tau = tau_up if u[i] >= state else tau_down
            state = u[i] + (state - u[i]) * np.exp(-busy / tau)
        y[i] = state
    return y


@kernel
def switch(run, u, on, off):
    """1 once u >= on, 0 once u <= off, else the value before; a run starts at 0 unless u >= on."""
    y = np.empty(u.size)
    state = 0.0
    for i in range(u.size):
        if i == 0 or run[i] != run[i - 1]:
            state = 0.0
        if u[i] >= on:
            state = 1.0
        elif u[i] <= off:
            state = 0.0
        y[i] = state
    return y


@kernel
def direction_of_travel(run, x, threshold, start):
    """+1 or -1 per row: turns once x has gone back by more than `threshold` from its extreme."""
    d = np.empty(x.size)
    state = float(start)
    extreme = 0.0
    for i in range(x.size):
        if i == 0 or run[i] != run[i - 1]:
            state = float(start)
            extreme = x[i]
        if state > 0:
            if x[i] >= extreme:
                extreme = x[i]
            elif extreme - x[i] > threshold:
                state = -1.0
                extreme = x[i]
        else:
            if x[i] <= extreme:
                extreme = x[i]
            elif x[i] - extreme > threshold:
                state = 1.0
                extreme = x[i]
        d[i] = state
    return d


@kernel
def approach(run, x, d, length, overrun=0.0):
    """z -> d exponentially over travelled length; starts saturated at the first direction of a run.

    overrun: mm of travel that each change of direction adds and no row shows.
    """
    z = np.empty(x.size)
    state = 0.0
    for i in range(x.size):
        if i == 0 or run[i] != run[i - 1]:
            state = d[i]
        else:
            way = abs(x[i] - x[i - 1])
            if d[i] != d[i - 1]:
                way += overrun
            state = d[i] - (d[i] - state) * np.exp(-way / length)
        z[i] = state
    return z


@kernel
def lookup(u, start, step, values):
    """Linear interpolation in a uniform table, held at its ends; NaN stays NaN."""
    y = np.empty(u.size)
    last = values.size - 1
    for i in range(u.size):
        s = (u[i] - start) / step
        if np.isnan(s):
            y[i] = np.nan
        elif s <= 0.0:
            y[i] = values[0]
        elif s >= last:
            y[i] = values[last]
        else:
            j = int(s)
            f = s - j
            y[i] = values[j] * (1.0 - f) + values[j + 1] * f
    return y


@kernel
def vibration(run, t, u, frequency, damping, pause):
    """Response q of q'' + 2 damping w q' + w^2 q = w^2 u with w = 2 pi frequency, and q' / w; Hz, shape (rows, 2).

    Exact for u that runs straight from row to row; in equilibrium at the start of a run and after a step longer than
    `pause` s; u must not miss and damping is below 1.
    """
    y = np.zeros((u.size, 2))
    w = 2 * np.pi * frequency
    decay = damping * w
    ringing = w * np.sqrt(1 - damping * damping)
    step, fade, c, s = -1.0, 1.0, 1.0, 0.0
    q, rate = 0.0, 0.0
    for i in range(u.size):
        dt = t[i] - t[i - 1] if i > 0 else 0.0
        if i == 0 or run[i] != run[i - 1] or dt > pause:
            q, rate = u[i], 0.0
        elif dt > 0:
            if abs(dt - step) > 1e-9 * dt:
                step, fade = dt, np.exp(-decay * dt)
                c, s = np.cos(ringing * dt), np.sin(ringing * dt) / ringing
            slope = (u[i] - u[i - 1]) / dt
            late = 2 * damping / w * slope
            z, v = q - u[i - 1] + late, rate - slope
            q = fade * (z * c + (v + decay * z) * s) + u[i] - late
            rate = fade * (v * c - (decay * v + w * w * z) * s) + slope
        y[i, 0], y[i, 1] = q, rate / w
    return y


@kernel
def limited(run, t, f, limit, catch_up):
    """A force f that stays within -limit..limit, and makes up for the impulse it lacked: shape of f.

    The loop asks for f + J / T + S / (2 T)^2, J the impulse that was lacking, S its integral over time, T = catch_up
    in s: a position loop that is damped critically. It has caught up over a gap of 5 T. 0: nothing is made up for.
    """
    y = np.empty(f.size)
    lacking = behind = 0.0
    for i in range(f.size):
        dt = t[i] - t[i - 1] if i > 0 and run[i] == run[i - 1] else np.inf
        if not dt < 5.0 * catch_up or np.isnan(f[i]):
            dt = lacking = behind = 0.0
        asked = f[i]
        if catch_up > 0.0:
            asked += lacking / catch_up + behind / (4.0 * catch_up * catch_up)
        y[i] = min(max(asked, -limit), limit) if not np.isnan(asked) else asked
        if dt > 0.0:
            lacking += (f[i] - y[i]) * dt
            behind += lacking * dt
    return y
