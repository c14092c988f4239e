"""Asking a service's health port, as a supervisor does."""

from http.client import HTTPConnection


def get(port: int, path: str) -> tuple[int, str]:
    """Status and body of one page; (0, "") while nobody answers."""
    connection = HTTPConnection("127.0.0.1", port, timeout=3)
    try:
        connection.request("GET", path)
        reply = connection.getresponse()
        return reply.status, reply.read().decode()
    except OSError:
        return 0, ""
    finally:
        connection.close()


def metric(port: int, name: str) -> float:
    """Sum of all samples of one metric."""
    lines = [line for line in get(port, "/metrics")[1].splitlines() if line.startswith(name)]
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines)
