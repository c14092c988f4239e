"""dashboard: the live map in the operator's browser.

A client of the HTTP API and of nothing else: one connection to the API's stream is held here with the API key
(``relay``), and every browser gets it from this process's own ``/live`` (``web_app``). The page is NiceGUI (``page``),
its moving layer one canvas drawn by the modules in ``static/``; everything is served from here, nothing from elsewhere.
"""
