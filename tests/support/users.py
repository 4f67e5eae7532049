"""Users of a test's server, whose passwords cost little processor time."""

from guarded_opcua.security.passwords import Cost

CHEAP = Cost(n=2)  # 0.1 ms instead of 40 ms
