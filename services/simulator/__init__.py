"""A twin of the site: people, what cameras see of them, what their phones measure, and the truth.

``world`` makes it block after block from a scenario (``scenario_file``): people of ``crowd``, detections of ``cameras``
or pictures of ``video``, power of ``radio``, samples and batches of ``phones``, and ``faults``. Off-line it runs as
fast as it goes; ``service`` lets it happen now, and the other services cannot tell it from a real site.
"""
