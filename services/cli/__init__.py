"""The ``atrium`` command: start a site on this machine, record and replay it, measure it."""
