"""One api service in this process, on a real bus and a real port."""

import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.api.service import ApiService
from services.api.settings import ApiSettings
from shared.bus import Bus
from shared.runner import Health
from shared.site import Site

DEADLINE = 15.0


@contextmanager
def running(site: Site, project: Path, endpoint: str, port: int, **changes: object) -> Iterator[str]:
    """One api service, in this process, until the block ends; yields its address."""
    folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    changes = {"stream_keep_alive": 0.3, "api_database_url": f"sqlite:///{folder.name}/api.db"} | changes
    # Of its own: what is set up is saved beside the site file.
    site_file = Path(shutil.copy(project / "deploy/sites/hall/site.yaml", folder.name))
    settings = ApiSettings(
        site_file=site_file,
        profile="demo",
        bus=[endpoint],
        api_port=port,
        **changes,  # type: ignore[arg-type]
    )
    with folder, Bus([endpoint]) as bus:
        service = ApiService(settings, site, bus, Health.__new__(Health))
        # A second Health in one process would register its gauge twice.
        service.health.__dict__.update(_problems={}, _lock=threading.Lock(), ready=threading.Event())
        bus.announce(service.keys.alive("api", "0"))
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        address = f"http://127.0.0.1:{port}"
        assert service.health.ready.wait(DEADLINE)
        try:
            yield address
        finally:
            asked = time.monotonic()
            service.stop()
            thread.join(DEADLINE)
            assert not thread.is_alive()
            assert time.monotonic() - asked < 5.0, "a stop takes at most five seconds, open streams or not"
