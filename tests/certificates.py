"""A certificate for 127.0.0.1 that signed itself."""

import subprocess
from pathlib import Path


def make_certificate(folder: Path, certificate: str = "certificate.pem", key: str = "key.pem") -> Path:
    """Write certificate and key as PEM files into a folder; return the certificate, which is its own authority."""
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1",
         "-out", str(folder / certificate), "-keyout", str(folder / key)],
        check=True,
        capture_output=True,
    )  # fmt: skip
    return folder / certificate
