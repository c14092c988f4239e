"""The smallest real service, run as a process by test_runner.py; ``behaviour`` chooses what it does wrong."""

import time
from typing import Literal

from shared.runner import Service, ServiceError, main
from shared.settings import ServiceSettings, SettingsError
from shared.site import Site


class TinySettings(ServiceSettings):
    behaviour: Literal["good", "hang", "fail", "crash", "refuse", "ill", "anew"] = "good"


class Tiny(Service[TinySettings]):
    name = "tiny"
    Settings = TinySettings

    @classmethod
    def check(cls, settings: TinySettings, site: Site) -> None:
        if settings.behaviour == "refuse":
            raise SettingsError(f"behaviour: 'refuse' does not fit site {site.site}")

    def run(self) -> None:
        behaviour = self.settings.behaviour
        if behaviour == "fail":
            raise ServiceError("the camera fell off the wall")
        if behaviour == "crash":
            raise ZeroDivisionError("by accident")
        if behaviour == "anew":
            if self.site.name != "set up anew":
                self.health.degraded("first", "of the first life")
                self.begin_anew(self.site.model_copy(update={"name": "set up anew"}))
                return
            self.health.degraded("second", f"site {self.site.name}")
        if behaviour == "ill":
            self.health.degraded("camera", "the stream is silent")
        self.health.ready.set()
        while behaviour == "hang":
            time.sleep(60)  # deaf to everything
        self.stopping.wait()


if __name__ == "__main__":
    main(Tiny)
