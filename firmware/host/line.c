#include "line.h"

#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include "bench.h"

enum { WAIT_MS = 1, CHUNK = 256 };

struct queue {
    uint8_t bytes[1 << 16];
    uint16_t first; /* wraps with the buffer's size */
    uint16_t count;
};

static struct queue to_board;
static struct queue from_board;
static int port = -1;

static void push(struct queue *queue, uint8_t byte)
{
    if (queue->count < UINT16_MAX) {
        queue->bytes[(uint16_t)(queue->first + queue->count++)] = byte;
    }
}

static bool pop(struct queue *queue, uint8_t *byte)
{
    if (queue->count == 0) {
        return false;
    }
    *byte = queue->bytes[queue->first++];
    queue->count--;
    return true;
}

void bench_sent(uint8_t byte)
{
    push(&from_board, byte);
}

bool bench_arrives(uint8_t *byte)
{
    return pop(&to_board, byte);
}

void line_give(const uint8_t *data, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        push(&to_board, data[i]);
    }
}

bool line_take_sent(uint8_t *byte)
{
    return pop(&from_board, byte);
}

bool line_has_port(void)
{
    return port >= 0;
}

const char *line_open_port(void)
{
    port = posix_openpt(O_RDWR | O_NOCTTY);
    if (port < 0 || grantpt(port) != 0 || unlockpt(port) != 0) {
        return NULL;
    }
    const char *path = ptsname(port);
    const int far_end = path == NULL ? -1 : open(path, O_RDWR | O_NOCTTY);
    struct termios settings;
    if (far_end < 0 || tcgetattr(far_end, &settings) != 0) {
        return NULL;
    }
    settings.c_lflag &= ~(tcflag_t)(ICANON | ECHO | ECHONL | ISIG | IEXTEN);
    settings.c_iflag &= ~(tcflag_t)(ICRNL | INLCR | IGNCR | IXON | ISTRIP | BRKINT | PARMRK);
    settings.c_oflag &= ~(tcflag_t)OPOST;
    tcsetattr(far_end, TCSANOW, &settings);
    fcntl(port, F_SETFL, O_NONBLOCK);
    close(far_end); /* from now on a hang-up at our end says that nobody listens */
    return path;
}

static bool somebody_listens(void)
{
    struct pollfd at_port = {.fd = port, .events = POLLOUT};
    return poll(&at_port, 1, 0) >= 0 && !(at_port.revents & POLLHUP);
}

static void deliver(bool listener)
{
    uint8_t chunk[CHUNK];
    size_t count = 0;
    while (count < CHUNK && pop(&from_board, &chunk[count])) {
        count++;
    }
    if (count > 0 && listener && write(port, chunk, count) != (ssize_t)count) {
        return; /* it listens but does not read: lost, too */
    }
}

bool line_exchange(void)
{
    const bool listener = somebody_listens();
    deliver(listener);
    const bool room = to_board.count < UINT16_MAX - CHUNK;
    struct pollfd sources[] = {{.fd = STDIN_FILENO, .events = POLLIN},
                               {.fd = listener && room ? port : -1, .events = POLLIN}};
    poll(sources, 2, WAIT_MS);
    if (sources[1].revents & POLLIN) {
        uint8_t chunk[CHUNK];
        const ssize_t count = read(port, chunk, sizeof chunk);
        line_give(chunk, count > 0 ? (size_t)count : 0);
    }
    return sources[0].revents != 0;
}
