"""A real MQTT broker for a test: Mosquitto, on a port of its own, which may go away and come back."""

import os
import shutil
import socket
import subprocess
from pathlib import Path

from conftest import unused_port
from waiting import wait_until


def _program(name: str) -> str:
    found = shutil.which(name, path=os.pathsep.join([os.environ["PATH"], "/usr/sbin", "/usr/local/sbin"]))
    assert found is not None, f"{name} is missing: scripts/system-packages.sh installs it"
    return found


class Mosquitto:
    """A broker that lets in whoever knows the password; its files lie in ``folder``.

    With a certificate it speaks TLS; the key is ``key.pem`` beside it.
    """

    USER, PASSWORD = "atrium", "a-password-of-tests"

    def __init__(self, folder: Path, certificate: Path | None = None) -> None:
        self.port = unused_port()
        scheme = "mqtt" if certificate is None else "mqtts"
        self.url = f"{scheme}://{self.USER}:{self.PASSWORD}@127.0.0.1:{self.port}"
        passwords = folder / "passwords"
        passwords.write_text(f"{self.USER}:{self.PASSWORD}\n")
        passwords.chmod(0o600)
        subprocess.run([_program("mosquitto_passwd"), "-U", str(passwords)], check=True)
        lines = [f"listener {self.port} 127.0.0.1", "allow_anonymous false", f"password_file {passwords}"]
        if certificate is not None:
            lines += [f"certfile {certificate}", f"keyfile {certificate.with_name('key.pem')}"]
        if passwords.owner() == "root":
            lines.append("user root")
        settings = folder / "mosquitto.conf"
        settings.write_text("\n".join([*lines, "log_type error", ""]))
        self._command = [_program("mosquitto"), "-c", str(settings)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(self._command)
        wait_until(self._listens, 10, "Mosquitto to listen")

    def stop(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait(5)
            self._process = None

    def _listens(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, "Mosquitto ended by itself"
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0
