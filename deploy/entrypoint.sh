#!/bin/sh
# The command of the container. A transport or an option of the agent starts the agent, as in the
# image microros/micro-ros-agent; anything else is a command of uros.
case "${1-}" in
--help | --version) exec uros "$@" ;;
udp4 | udp6 | tcp4 | tcp6 | serial | multiserial | pseudoterminal | canfd | rfcomm | custom | -*)
    exec uros agent "$@"
    ;;
esac
exec uros "$@"
