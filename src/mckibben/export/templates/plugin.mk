# Builds the plugin against an installed MuJoCo: default: Python's.
CC ?= cc
MUJOCO ?= $(shell python3 -c "import mujoco, os; print(os.path.dirname(mujoco.__file__))")
CFLAGS = -std=c99 -O2 -fPIC -Wall -Wextra

lib${name}.so: ${name}.c plugin.c ${name}.h
	$(CC) $(CFLAGS) -shared -I$(MUJOCO)/include -o $@ ${name}.c plugin.c $(wildcard $(MUJOCO)/libmujoco.so*) -lm
