"""Helpers that several groups of tests share.

They are agents in a thread, lines to them, replayed clients, an XRCE client, and modules that tests
on MicroPython import too.
"""
