"""The command ``uros``: one module a verb, imported when the verb is used. See ``cli``."""
