"""Benchmarks, one module per figure. `python -m benchmarks NAME` prints a JSON object: value, unit, target, …"""
