# `make run` and `make test` set everything up first; a second call starts at once.
.PHONY: run test quick check-results types check docs test-docs setup clean

# Compiled modules are kept, also where the environment forbids it: every process would compile them anew.
unexport PYTHONDONTWRITEBYTECODE

UV := .boot/bin/uv
PYTHON := .venv/bin/python
PYTEST := OMP_NUM_THREADS=1 $(PYTHON) -m pytest

run: .venv/.ready
	$(PYTHON) -m benchmark.run robot=ur3 lambda=0.5

# Everything but the checks of what is committed in results/.
test: setup
	$(PYTEST) -m "not results"

# Facts and the toy task: no processes, no browser, no shipped policies.
quick: .venv/.ready
	$(PYTEST) -m "not system and not results"

# What is committed in results/ and the documents.
check-results: .venv/.ready
	$(PYTEST) -m results

types: .venv/.ready
	.venv/bin/mypy --python-executable $(PYTHON)

check: setup types check-results
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	$(PYTEST) -m "not results"

# The documents as a site, in outputs/docs; a warning, such as a link that leads nowhere, fails.
docs: .venv/.ready
	$(PYTHON) -m sphinx -W --keep-going -q -b html docs outputs/docs

# The Python blocks of the documents.
test-docs: .venv/.ready
	$(PYTEST) -n 0 README.md docs

setup: .venv/.ready .venv/.browser

# A folder of its own works with any pip, also where the system's packages are closed to it; from / pyenv is not asked
# for the version that .python-version names.
$(UV):
	cd / && python3 -m pip install --quiet --target "$(CURDIR)/.boot" uv

# Pictures need EGL, which Python packages cannot bring; everything else works without it.
.venv/.ready: pyproject.toml .python-version $(UV)
	@$(UV) python find --quiet >/dev/null 2>&1 || $(UV) python install --quiet \
	|| { echo "Python 3.12 is not on this machine and could not be fetched. Install it, with python3.12 on the PATH."; exit 1; }
	$(UV) sync
	@$(PYTHON) -c "import ctypes; ctypes.CDLL('libEGL.so.1')" 2>/dev/null \
	|| { [ "$$(id -u)" = 0 ] && apt-get update -qq && apt-get install -y -qq libegl1 libgl1-mesa-dri; } \
	|| echo "No EGL on this machine: no pictures. On Debian: sudo apt-get install libegl1 libgl1-mesa-dri"
	@touch $@

# The leaderboard's page is tested in a browser; without one that test is skipped.
.venv/.browser: .venv/.ready
	@command -v chromedriver >/dev/null \
	|| { [ "$$(id -u)" = 0 ] && apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium chromium-driver; } \
	|| echo "No Chromium on this machine: its page is not tested. On Debian: sudo apt-get install chromium chromium-driver"
	@touch $@

clean:
	rm -rf .venv .boot uv.lock
