"""What zones tell: tracks and zones in; alerts and counts of people out.

``crossings`` and below is who entered, left and crossed what, ``watch`` what of it, and of those inside, is told of
whom; all of it is pure. ``service`` wires it to the bus. docs/zones.md says what a rule means.
"""
