"""An agent in a child process."""

import os
import signal

import pytest

from uros.tools.agent.child_process import AgentProcess


def test_the_end_is_seen_without_the_lock_of_popen(own_domain_id, monkeypatch):
    """A signal handler that raises within Popen.poll() can leave its lock taken."""
    lines = []
    agent = AgentProcess(("udp4", "-p", "0", "-m", "memory"), own_domain_id, lines.append)

    def poll():
        pytest.fail("the lock of Popen is taken")

    with monkeypatch.context() as patch:
        patch.setattr(agent._process, "poll", poll)
        assert not agent.ended
        os.kill(agent.pid, signal.SIGKILL)
        agent._reader.join(20)
        assert agent.ended
    agent.close()
    agent.close()
