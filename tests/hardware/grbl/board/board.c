/* An Arduino Mega 2560 with a gantry, for grbl-Mega firmware: simavr behind a pty.
 *
 *     board IMAGE.hex SHARED PACE X Y Z
 *
 * IMAGE: the firmware, unmodified. SHARED: a file of 8 numbers of 8 bytes that is mapped (`enum`, below). PACE: board
 * seconds a real second, at most. X Y Z: where the carriage stands, in steps from the lower corner of the workspace.
 * The pty's name is the first line of output. Commands on standard input, one letter a line: r presses the reset
 * button; x y z close a limit switch for good, X Y Z let it go; m takes the motors' power, M gives it back.
 *
 * A switch also closes by itself where the carriage is a pull-off beyond the upper end of the workspace. Steps are
 * counted as writes of the step port: where the firmware is late to end a pulse, simavr tells of two pulses as one.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_hex.h>

#define HZ 16000000ULL
#define SLICE (HZ / 2000) /* cycles between two looks at the outside world: half a millisecond */
#define PORTA 0x22
#define EECR 0x3f
#define EEAR 0x41
#define TCCR1B 0x81
#define OCR1A 0x88
enum { CYCLES, STEPS_X, STEPS_Y, STEPS_Z, HOME_X, HOME_Y, HOME_Z, IS_LIVE };

static const int STEP_BIT[3] = {2, 3, 4}, DIRECTION_BIT[3] = {7, 6, 5}, LIMIT_BIT[3] = {4, 5, 6};
static avr_t *avr;
static volatile int64_t *shared;
static avr_irq_t *limit_pin[3], *uart_in;
static uint8_t directions, said[4096];
static int is_pressed[3], is_closed[3], has_motors = 1, may_send = 1, pty_end, n_said;

static void show_switches(void) {
	for (int axis = 0; axis < 3; axis++) {
		int closed = is_pressed[axis] || shared[STEPS_X + axis] >= shared[HOME_X + axis];
		if (closed != is_closed[axis])
			avr_raise_irq(limit_pin[axis], !closed); /* pulled up: closed is low */
		is_closed[axis] = closed;
	}
}

static void on_directions(avr_irq_t *irq, uint32_t value, void *param) {
	directions = value;
}

static void on_steps(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param) {
	for (int axis = 0; axis < 3; axis++)
		if (value & 1 << STEP_BIT[axis] && has_motors)
			shared[STEPS_X + axis] += directions & 1 << DIRECTION_BIT[axis] ? -1 : 1;
	show_switches();
}

static void on_said(avr_irq_t *irq, uint32_t value, void *param) {
	if (n_said < (int)sizeof said)
		said[n_said++] = value;
}

static void on_room(avr_irq_t *irq, uint32_t value, void *param) {
	may_send = param != NULL;
}

/* simavr never starts a timer whose limit is 0; the real one runs, and GRBL sets its limit in the first interrupt. */
static void start_timer(void) {
	if ((avr->data[TCCR1B] & 7) && !avr->data[OCR1A] && !avr->data[OCR1A + 1]) {
		avr->data[OCR1A + 1] = 0x10;
		avr->io[AVR_DATA_TO_IO(OCR1A)].w.c(avr, OCR1A, 0, avr->io[AVR_DATA_TO_IO(OCR1A)].w.param);
	}
}

/* simavr knows no write that only erases, which GRBL uses for bytes that become 255. */
static void on_eeprom(avr_t *avr, avr_io_addr_t address, uint8_t value, void *param) {
	uint8_t erased = 0xff;
	avr_eeprom_desc_t byte = {.ee = &erased, .offset = avr->data[EEAR] | avr->data[EEAR + 1] << 8, .size = 1};
	if ((value & 0x32) == 0x12)
		avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &byte);
}

static void press_reset(void) {
	avr_cycle_count_t cycle = avr->cycle;
	avr_reset(avr);
	avr->cycle = cycle;
	may_send = 1;
	for (int axis = 0; axis < 3; axis++) { /* the reset forgot them, and hears only what changes */
		avr_raise_irq(limit_pin[axis], is_closed[axis]);
		avr_raise_irq(limit_pin[axis], !is_closed[axis]);
	}
}

static void obey(char letter) {
	static const char axes[] = "xyzXYZ";
	const char *axis = strchr(axes, letter);
	if (letter == 'r')
		press_reset();
	else if (letter == 'm' || letter == 'M')
		has_motors = letter == 'M';
	else if (axis != NULL && letter)
		is_pressed[(axis - axes) % 3] = axis - axes < 3;
	show_switches();
}

int main(int argc, char **argv) {
	if (argc != 7)
		return fprintf(stderr, "board IMAGE.hex SHARED PACE X Y Z\n"), 2;
	uint32_t size = 0, start = 0;
	uint8_t *image = read_ihex_file(argv[1], &size, &start);
	avr = avr_make_mcu_by_name("atmega2560");
	int file = open(argv[2], O_RDWR), slave;
	struct termios raw;
	cfmakeraw(&raw);
	if (!image || !avr || file < 0 || openpty(&pty_end, &slave, NULL, &raw, NULL))
		return perror("board"), 1;
	shared = mmap(NULL, 64, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
	double pace = atof(argv[3]);
	for (int axis = 0; axis < 3; axis++)
		shared[STEPS_X + axis] = atoll(argv[4 + axis]);
	avr_init(avr);
	avr->frequency = HZ;
	avr->log = 0;
	avr_loadcode(avr, image, size, start);
	uint32_t flags = 0;
	avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
	uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_said, NULL);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_room, avr);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_room, NULL);
	avr_register_io_write(avr, PORTA, on_steps, NULL);
	avr_register_io_write(avr, EECR, on_eeprom, NULL);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('C'), IOPORT_IRQ_REG_PORT), on_directions, NULL);
	for (int axis = 0; axis < 3; axis++) {
		limit_pin[axis] = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), IOPORT_IRQ_PIN0 + LIMIT_BIT[axis]);
		avr_raise_irq(limit_pin[axis], 1);
	}
	show_switches();
	fcntl(pty_end, F_SETFL, O_NONBLOCK);
	fcntl(0, F_SETFL, O_NONBLOCK);
	printf("%s\n", ttyname(slave));
	fflush(stdout);
	shared[IS_LIVE] = 1;
	struct timespec now, begun;
	clock_gettime(CLOCK_MONOTONIC, &begun);
	double late_s = 0; /* real time that a busy machine has cost: it is not made up for */
	uint8_t waiting[256];
	int n_waiting = 0, is_at = 0;
	for (avr_cycle_count_t until = avr->cycle + SLICE;; until += SLICE) {
		while (avr->cycle < until) {
			int state = avr_run(avr);
			if (state == cpu_Done || state == cpu_Crashed)
				return fprintf(stderr, "the firmware has crashed\n"), 1;
		}
		shared[CYCLES] = avr->cycle;
		start_timer();
		if (is_at == n_waiting) {
			n_waiting = read(pty_end, waiting, sizeof waiting);
			is_at = 0;
			n_waiting = n_waiting < 0 ? 0 : n_waiting;
		}
		while (may_send && is_at < n_waiting)
			avr_raise_irq(uart_in, waiting[is_at++]);
		if (n_said > 0) {
			int n = write(pty_end, said, n_said);
			if (n > 0)
				memmove(said, said + n, n_said -= n);
		}
		char letter;
		int n = read(0, &letter, 1);
		if (n == 0)
			return 0; /* whoever started it is gone */
		if (n == 1)
			obey(letter);
		clock_gettime(CLOCK_MONOTONIC, &now);
		double real_s = now.tv_sec - begun.tv_sec + 1e-9 * (now.tv_nsec - begun.tv_nsec);
		double ahead_s = (double)avr->cycle / HZ / pace - (real_s - late_s);
		if (ahead_s > 0.001)
			usleep(ahead_s * 1e6);
		else if (ahead_s < -0.01)
			late_s -= ahead_s;
	}
}
