"""The plain methods of the original studies: what one sensor alone, or both joined in the obvious way, can do.

They anchor how difficult a simulated scenario is, and are what every identity tracker has to beat. Their parameters
were chosen once, on a small world of the tests, and are never tuned on a scenario.
"""
