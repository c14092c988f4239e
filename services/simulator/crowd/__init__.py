"""Who walks where? People on a plan, by their agendas and among each other, or after a recorded file."""
