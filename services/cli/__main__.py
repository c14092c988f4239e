"""``python -m services.cli`` is the ``atrium`` command."""

import sys

try:
    from services.cli.main import main

    main()
except KeyboardInterrupt:  # also while the libraries are still being loaded
    sys.exit(130)
