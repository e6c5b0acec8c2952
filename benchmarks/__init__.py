"""One module a figure. `python -m benchmarks NAME` prints one JSON object: value, unit, target, sizes, device, …"""
