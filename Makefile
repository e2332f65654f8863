# `make demo` and `make test` do all the set-up themselves; a second call starts at once.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:

VENV := .venv
PY := $(VENV)/bin/python
APT_LIBRARIES := libusb-1.0-0 libgl1 libegl1 libgomp1

.PHONY: demo test lint results clean

demo: $(VENV)/.ready
	@echo "Two scans of a simulated room are registered."
	$(PY) register.py

test: lint
	@echo "Tests, two at a time: some minutes on two processors."
	$(PY) -m pytest -n 2

lint: $(VENV)/.ready-for-tests
	@echo "Style, types and the order of imports are checked."
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check --quiet .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-cache

results: $(VENV)/.ready-for-tests
	@echo "Every table of docs/results.md: forty minutes on two quiet processors; a second call goes on."
	$(PY) -m skipnet study results $(if $(DATA),data=$(DATA))

clean:
	rm -rf $(VENV) build *.egg-info runs outputs multirun

# Installs Debian packages as root or through sudo, or says exactly what to type.
define apt_install
apt_install() {
	local root=""
	[ "$$(id -u)" = 0 ] || root="sudo"
	if [ -n "$$root" ] && ! sudo -n true 2>/dev/null; then
		echo "This machine lacks Debian packages. Please run, then repeat make:" >&2
		echo "    sudo apt-get update && sudo apt-get install -y $$*" >&2
		exit 1
	fi
	echo "Installing Debian packages: $$*"
	$$root apt-get update -qq
	DEBIAN_FRONTEND=noninteractive $$root apt-get install -y -qq --no-install-recommends "$$@" >/dev/null
}
endef

$(PY):
	@$(apt_install)
	for name in $${PYTHON:-} python3 python3.13 python3.12 python3.11 python3.10; do
		if "$$name" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; then
			python="$$name"
			break
		fi
	done
	if [ -z "$${python:-}" ]; then
		echo "skipnet needs Python 3.10 or newer; name one with: make PYTHON=/path/to/python" >&2
		exit 1
	fi
	"$$python" -c 'import ensurepip, venv' 2>/dev/null || apt_install python3-venv
	echo "1 of 4: a virtual environment in $(VENV), with $$("$$python" --version)"
	"$$python" -m venv $(VENV)

$(VENV)/.ready: pyproject.toml | $(PY)
	@$(apt_install)
	echo "2 of 4: skipnet and what it needs (PyTorch, Open3D and others: one to two gigabytes, some minutes)"
	$(PY) -m pip install -qq -e '.[formats]'
	echo "3 of 4: Debian's libraries for Open3D, where they are missing"
	$(PY) -c 'import open3d' 2>/dev/null || apt_install $(APT_LIBRARIES)
	$(PY) -c 'import open3d'
	echo "4 of 4: the loops over points are compiled, half a minute, so that no first call waits for it"
	$(PY) -m skipnet compile
	touch $@

$(VENV)/.ready-for-tests: pyproject.toml $(VENV)/.ready
	@echo "What the tests need: pytest, ruff, mypy, KISS-Matcher and readers of LAS and E57"
	$(PY) -m pip install --quiet -e '.[test,peers,formats]'
	touch $@
