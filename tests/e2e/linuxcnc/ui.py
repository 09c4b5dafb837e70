#!/usr/bin/python3
"""What LinuxCNC takes for its screen: switches the machine on, homes it, heats it, runs a program, records, leaves.

Runs under Debian's Python (the hal and linuxcnc modules); reads plan.json and writes facts.json beside itself.
"""

import json
import os
import signal
import subprocess
import sys
import time

import hal
import linuxcnc

os.chdir(os.path.dirname(os.path.abspath(__file__)))
with open("plan.json") as plan:
    PLAN = json.load(plan)
ui = hal.component("screen")
ui.ready()  # hal.get_value and set_p need a component of one's own
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
output = []


def poll():
    status.poll()
    message = errors.poll()
    if message:
        output.append(message[1])
        print("LINUXCNC:", message, flush=True)


def wait(what, condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        poll()
        if time.monotonic() > end:
            raise RuntimeError(f"waited {seconds} s for {what}")
        time.sleep(0.01)


def idle():
    status.poll()
    return status.interp_state == linuxcnc.INTERP_IDLE and status.inpos and status.exec_state == linuxcnc.EXEC_DONE


def set_pins(pins):
    for name, value in pins.items():
        hal.set_p(name, str(value))


def switch_on():
    wait("the start", lambda: idle() and status.task_state == linuxcnc.STATE_ESTOP, 20)
    for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
        command.state(state)
        command.wait_complete(10)
    command.home(-1)
    wait("homing", lambda: all(status.homed[: PLAN.get("joints", 3)]), 20)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete(10)
    time.sleep(PLAN["settle_s"])


def run_program():
    command.program_open(os.path.abspath("program.ngc"))
    command.wait_complete(10)
    command.auto(linuxcnc.AUTO_RUN, 0)
    command.wait_complete(10)
    wait("the program", idle, PLAN["program_s"])


def settled(read):
    """What `read` gives once it stays for a second: counts go in slowly, more slowly still on a busy machine."""
    last, now = None, read()
    for _ in range(30):
        if now == last:
            break
        time.sleep(1.0)
        last, now = now, read()
    return now


def emergency_stops(count):
    """What some pins read before the first stop, and after each one and going on; `while_stopped` in each stop too."""
    names = PLAN.get("stop_pins", ["errpipe.command-x"])

    def read():
        values = [hal.get_value(name) for name in names]
        return values if len(values) > 1 else values[0]

    places = [settled(read)]
    for _ in range(count):
        for state in (linuxcnc.STATE_ESTOP, linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
            command.state(state)
            command.wait_complete(10)
            time.sleep(0.5)
            if state == linuxcnc.STATE_ESTOP and PLAN.get("while_stopped"):
                set_pins(PLAN["while_stopped"])
                time.sleep(0.3)
                places.append(read())
                set_pins(PLAN["heat"])
                time.sleep(0.3)
        places.append(read())
    if PLAN.get("go_on"):
        command.mode(linuxcnc.MODE_AUTO)
        command.wait_complete(10)
        run_program()
        places.append(read())
    return places


def main():
    switch_on()
    started, cycles = time.monotonic(), hal.get_value("errpipe.heartbeat")
    with open("record.txt", "w") as out:
        sampler = subprocess.Popen(["halsampler", "-c", "0", "-t"], stdout=out, stdin=subprocess.DEVNULL)
    time.sleep(0.2)
    set_pins(PLAN["heat"])
    rounds = 0
    while rounds == 0 or time.monotonic() - started < PLAN["least_s"]:
        if rounds % 4 == 2:
            set_pins(PLAN["cool"])
        elif rounds % 4 == 0:
            set_pins(PLAN["heat"])
        run_program()
        rounds += 1
    elapsed, cycles = time.monotonic() - started, hal.get_value("errpipe.heartbeat") - cycles
    time.sleep(0.2)
    sampler.send_signal(signal.SIGINT)
    sampler.wait(20)
    facts = {"elapsed_s": elapsed, "cycles": cycles, "rounds": rounds, "output": output}
    facts["stops"] = emergency_stops(PLAN["stops"]) if PLAN.get("stops") else []
    facts["overruns"] = hal.get_value("sampler.0.overruns")
    for name in ("errpipe", "motion-controller", "servo-thread"):
        facts[name + ".tmax"] = hal.get_value(name + ".tmax")
    for name in PLAN["read"]:
        facts[name] = hal.get_value(name)
    with open("facts.json", "w") as out:
        json.dump(facts, out)


try:
    main()
except Exception as problem:
    print("SCREEN:", repr(problem), flush=True)
    sys.exit(1)
