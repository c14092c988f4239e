"""How well would another model explain the last minutes? Asked over the bus, answered by a process of low priority."""
