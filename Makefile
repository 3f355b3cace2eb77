# Each of these needs only Python 3.10 to 3.14, git and make: what is missing goes into .venv.
#
#   make demo [SECONDS=20]   a virtual board, through the agent, on the ROS 2 network
#   make board [NAME=...]    a virtual board and an agent; NAME=list has them
#   make quick               lint and the unit tests without the long ones: for daily work
#   make test                all tests that a change must pass
#   make test-full           these, the slow ones, those with ROS on rtps too, and on Jazzy
#   make test-arm64          the quick tests and the demo in an emulated Debian on arm64; as root
#   make coverage            how much of wire and agent their own tests reach
#   make fuzz [TARGET=...] [SECONDS=600]   any bytes against one part, or all
#   make soak [SECONDS=3600] a hundred boards that come and go
#   make lint                ruff, and mypy for hosts and for boards
#   make docs                the documentation site, in build/site
#   make bench [ARGS=...]    the agent beside the bare relay
#   make bench-board         what a board pays, as one JSON object
#   make deb                 a Debian package of uros, in dist
#   make release             the files of a release, in dist
#   make clean               removes everything that the others have made
#
# PYTHON=/path/to/python chooses the interpreter that .venv is made with.

PYTHON ?= python3

.PHONY: demo board quick test test-full test-arm64 coverage fuzz soak lint docs bench bench-board deb release clean

demo:
	@$(PYTHON) scripts/env.py run
	@.venv/bin/uros demo $(if $(SECONDS),--seconds $(SECONDS))

board:
	@$(PYTHON) scripts/env.py run
	@.venv/bin/uros board $(if $(filter list,$(NAME)),list,run $(or $(NAME),esp32_button_led)) $(ARGS)

quick:
	@$(PYTHON) scripts/env.py dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	@.venv/bin/pytest -q -n 2 --dist loadfile -m "not slow and not long" \
	    --hypothesis-profile=quick tests/unit $(ARGS)

test:
	@$(PYTHON) scripts/env.py test
	@.venv/bin/python tests/run.py $(ARGS)

test-full:
	@$(PYTHON) scripts/env.py test
	@.venv/bin/python tests/run.py --full $(ARGS)
	@$(if $(ARGS),,.venv/bin/python tests/run.py --middleware rtps)
	@$(if $(ARGS),,.venv/bin/python tests/run.py --ros jazzy)
	@$(if $(ARGS),,.venv/bin/python scripts/cover.py)

test-arm64:
	@$(PYTHON) scripts/arm64.py $(ARGS)

coverage:
	@$(PYTHON) scripts/env.py test
	@.venv/bin/python scripts/cover.py

fuzz:
	@$(PYTHON) scripts/env.py fuzz
	@.venv/bin/python fuzz/run.py $(or $(TARGET),all) --seconds $(or $(SECONDS),600)

soak:
	@$(PYTHON) scripts/env.py test
	@.venv/bin/python tests/soak/soak.py --seconds $(or $(SECONDS),3600)

lint:
	@$(PYTHON) scripts/env.py dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/python scripts/lint_boards.py
	@.venv/bin/python scripts/long_files.py

docs:
	@$(PYTHON) scripts/env.py docs
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict
	@echo "to see it: python3 -m http.server --directory build/site --bind 127.0.0.1"

bench:
	@$(PYTHON) scripts/env.py test
	@.venv/bin/python bench/run.py $(ARGS)

bench-board:
	@$(PYTHON) scripts/env.py test >&2
	@$(PYTHON) scripts/env.py micropython >&2
	@.venv/bin/python bench/board.py

deb:
	@$(PYTHON) scripts/env.py run
	@.venv/bin/python scripts/deb.py $(ARGS)

release:
	@$(PYTHON) scripts/env.py release
	@.venv/bin/python scripts/release.py $(ARGS)

clean:
	rm -rf .venv .venv-ros .venv-ros-jazzy build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
