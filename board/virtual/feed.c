// Plays a raw YUYV clip into the kernel's vivid driver: what is written to /dev/video1 comes out of /dev/video0.
//
// usage: feed CLIP WIDTH HEIGHT [HOLD [DROP]]    plays CLIP forward, then backward, for ever; every frame is held for
// HOLD frame periods (default 1). The camera loses DROP % of its frames (default 0), which saves the board's time.
// Needs a DV timing of WIDTHxHEIGHT. Prints "feeding" once frames flow.
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static void fail(const char *what) {
    fprintf(stderr, "feed: %s: %s\n", what, strerror(errno));
    exit(1);
}

static void request(int fd, unsigned long number, void *argument, const char *what) {
    int result;
    do result = ioctl(fd, number, argument); while (result < 0 && errno == EINTR);
    if (result < 0) fail(what);
}

static int open_node(const char *path) {
    int fd = open(path, O_RDWR);
    if (fd < 0) fail(path);
    return fd;
}

// both ends of the virtual cable must carry the same signal
static void set_timings(int fd, unsigned width, unsigned height) {
    struct v4l2_enum_dv_timings each = {0};
    for (; ioctl(fd, VIDIOC_ENUM_DV_TIMINGS, &each) == 0; each.index++)
        if (each.timings.bt.width == width && each.timings.bt.height == height && !each.timings.bt.interlaced) {
            request(fd, VIDIOC_S_DV_TIMINGS, &each.timings, "set DV timings");
            return;
        }
    fail("no DV timing of this size");
}

// vivid's own controls have no stable numbers: find them by name
static void set_control(int fd, const char *name, int value) {
    struct v4l2_queryctrl each = {.id = V4L2_CTRL_FLAG_NEXT_CTRL};
    for (; ioctl(fd, VIDIOC_QUERYCTRL, &each) == 0; each.id |= V4L2_CTRL_FLAG_NEXT_CTRL)
        if (strcmp((const char *)each.name, name) == 0) {
            struct v4l2_control control = {.id = each.id, .value = value};
            request(fd, VIDIOC_S_CTRL, &control, name);
            return;
        }
    fail(name);
}

int main(int argc, char **argv) {
    if (argc < 4) return fprintf(stderr, "usage: feed CLIP WIDTH HEIGHT [HOLD [DROP]]\n"), 2;
    const unsigned width = atoi(argv[2]), height = atoi(argv[3]), hold = argc > 4 ? atoi(argv[4]) : 1;
    const size_t bytes = (size_t)width * height * 2;

    int clip = open(argv[1], O_RDONLY);
    struct stat info;
    if (clip < 0 || fstat(clip, &info) < 0) fail(argv[1]);
    const long count = info.st_size / bytes;
    if (count < 1) return fprintf(stderr, "feed: %s: not one whole frame\n", argv[1]), 1;
    char *frames = malloc(count * bytes);
    for (size_t have = 0; have < count * bytes;) {
        ssize_t part = read(clip, frames + have, count * bytes - have);
        if (part <= 0) fail(argv[1]);
        have += part;
    }

    int camera = open_node("/dev/video0"), output = open_node("/dev/video1");
    set_timings(camera, width, height);
    set_timings(output, width, height);
    set_control(camera, "OSD Text Mode", 2);
    set_control(camera, "Loop Video", 1);
    set_control(camera, "Percentage of Dropped Buffers", argc > 5 ? atoi(argv[5]) : 0);

    const enum v4l2_buf_type type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    struct v4l2_format format = {.type = type};
    format.fmt.pix = (struct v4l2_pix_format){
        .width = width, .height = height, .pixelformat = V4L2_PIX_FMT_YUYV, .field = V4L2_FIELD_NONE};
    request(output, VIDIOC_S_FMT, &format, "set format");
    if (format.fmt.pix.sizeimage != bytes || format.fmt.pix.pixelformat != V4L2_PIX_FMT_YUYV)
        return fprintf(stderr, "feed: the driver changed the format\n"), 1;

    struct v4l2_requestbuffers wanted = {.count = 4, .type = type, .memory = V4L2_MEMORY_MMAP};
    request(output, VIDIOC_REQBUFS, &wanted, "request buffers");
    char *maps[32];
    for (unsigned i = 0; i < wanted.count && i < 32; i++) {
        struct v4l2_buffer buffer = {.type = type, .memory = V4L2_MEMORY_MMAP, .index = i};
        request(output, VIDIOC_QUERYBUF, &buffer, "query buffer");
        maps[i] = mmap(0, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, output, buffer.m.offset);
        if (maps[i] == MAP_FAILED) fail("map buffer");
    }

    for (unsigned long n = 0;; n++) {
        struct v4l2_buffer buffer = {.type = type, .memory = V4L2_MEMORY_MMAP, .index = n};
        if (n >= wanted.count) request(output, VIDIOC_DQBUF, &buffer, "dequeue");
        const long step = n / hold, period = count > 1 ? 2 * (count - 1) : 1, at = step % period;
        memcpy(maps[buffer.index], frames + (at < count ? at : period - at) * bytes, bytes);
        buffer.bytesused = bytes;
        buffer.field = V4L2_FIELD_NONE;
        request(output, VIDIOC_QBUF, &buffer, "queue");
        if (n + 1 == wanted.count) request(output, VIDIOC_STREAMON, (void *)&type, "start");
        if (n == 2 * wanted.count) puts("feeding"), fflush(stdout);
    }
}
