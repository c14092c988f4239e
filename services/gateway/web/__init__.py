"""The gateway's HTTP: routes, who may ask, how errors are told."""
