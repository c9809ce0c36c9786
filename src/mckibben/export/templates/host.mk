CFLAGS = -std=c99 -O2 -Wall -Wextra -Wpedantic -Wconversion -Werror

firmware: host.c simulated.c firmware.c link.c controller.c plant.c
	$(CC) $(CFLAGS) -o $@ $^ -lm

clean:
	rm -f firmware

.PHONY: clean
