// Sets a control of a video device by its name, as the kernel tells it; buttons are pressed with any value.
//
// usage: ctl NODE NAME VALUE
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

int main(int count, char **words) {
    if (count != 4) {
        fprintf(stderr, "usage: ctl NODE NAME VALUE\n");
        return 2;
    }
    int fd = open(words[1], O_RDWR);
    if (fd < 0) {
        fprintf(stderr, "ctl: %s: %s\n", words[1], strerror(errno));
        return 1;
    }
    struct v4l2_queryctrl query = { .id = V4L2_CTRL_FLAG_NEXT_CTRL };
    while (ioctl(fd, VIDIOC_QUERYCTRL, &query) == 0) {
        if (strcmp((const char *)query.name, words[2]) == 0) {
            struct v4l2_control control = { .id = query.id, .value = atoi(words[3]) };
            if (ioctl(fd, VIDIOC_S_CTRL, &control) == 0) {
                close(fd);
                return 0;
            }
            fprintf(stderr, "ctl: %s: %s\n", words[2], strerror(errno));
            return 1;
        }
        query.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
    }
    fprintf(stderr, "ctl: %s has no control \"%s\"\n", words[1], words[2]);
    return 1;
}
