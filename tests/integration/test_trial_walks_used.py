"""What trial walks told is used at once, survives a restart, and goes with the consent."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from gateway_process import Listener, Phone, Running, finish, is_ready, launch, problem
from trial_walking import trial_walk
from waiting import wait_until

SHORT = 0.6
"""Somebody whose steps are so much shorter than usual."""


def lengths(phone: Phone, listener: Listener, batches: range) -> list[float]:
    """The lengths of the steps that some batches led to."""
    _, before = listener.heard(phone.device)
    for seq in batches:
        assert phone.post(phone.batch(seq)).is_success
    wait_until(lambda: len(listener.heard(phone.device)[0]) == batches.stop, 10, "the scans")
    return [length for motion in listener.heard(phone.device)[1][len(before) :] for length in motion.length]


def test_trial_walks_are_used_at_once_and_after_a_restart_and_go_with_the_consent(
    tmp_path: Path, zenoh_router: str
) -> None:
    def start() -> Running:
        running = launch(zenoh_router, tmp_path)
        wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
        return running

    slow, quick = trial_walk(1, 1.1, 9.0), trial_walk(1, 1.6, 9.0)
    walks = [slow.body(steps=slow.steps), quick.body()]
    body = {"walks": [walk | {"distance": SHORT * walk["distance"]} for walk in walks]}
    gateway, listener = start(), Listener(zenoh_router)
    try:
        phone = Phone(gateway)
        assert np.mean(lengths(phone, listener, range(10))) > 0.6
        path = f"/v1/devices/{phone.device}/trial-walks"
        wrong = phone.http.put(path, json={"walks": body["walks"][1:]}, headers=phone.headers)
        assert (wrong.status_code, problem(wrong)["field"]) == (422, "walks[0].steps")
        answer = phone.http.put(path, json=body, headers=phone.headers)
        assert answer.status_code == 200, answer.text
        learned = answer.json()
        assert [walk["steps"] for walk in learned["walks"]] == pytest.approx([slow.steps, quick.steps], abs=1)
        expected = learned["slope"] * 1.9 + learned["offset"]  # the phone of these tests walks at 1.9 Hz
        assert lengths(phone, listener, range(10, 24))[-5:] == pytest.approx([expected] * 5, abs=0.03)
        assert finish(gateway) == 0
        gateway = start()
        phone.http = gateway.http
        restarted = lengths(phone, listener, range(24, 38))
        assert restarted[-5:] == pytest.approx([expected] * 5, abs=0.03)
        assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 204
        with closing(sqlite3.connect(gateway.database)) as database:
            assert database.execute("SELECT count(*) FROM gateway_walkers").fetchone() == (0,)
    finally:
        listener.bus.close()
        finish(gateway)
