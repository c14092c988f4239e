"""``python -m services.cli`` is the ``atrium`` command."""

from services.cli.main import main

main()
