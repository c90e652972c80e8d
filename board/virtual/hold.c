// Another program that has the screen: takes the card's mastership as soon as it is free, fills the screen with one
// color, keeps it for a while, and leaves.
//
// usage: hold CARD MILLISECONDS    prints "holding" once its picture is shown. The color is 40 80 c0 (hexadecimal).
#include <drm/drm.h>
#include <drm/drm_mode.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

static void request(int fd, unsigned long number, void *argument, const char *what) {
    int result;
    do result = ioctl(fd, number, argument); while (result < 0 && errno == EINTR);
    if (result < 0) {
        fprintf(stderr, "hold: %s: %s\n", what, strerror(errno));
        exit(1);
    }
}

int main(int count, char **words) {
    if (count != 3) return fprintf(stderr, "usage: hold CARD MILLISECONDS\n"), 2;
    int fd = open(words[1], O_RDWR);
    if (fd < 0) return perror(words[1]), 1;
    // whoever looks for a screen has it for moments
    for (int tries = 0; ioctl(fd, DRM_IOCTL_SET_MASTER, 0) < 0; tries++) {
        if (tries > 5000) return fprintf(stderr, "hold: the card is never free\n"), 1;
        usleep(1000);
    }

    uint32_t crtcs[16], connectors[16], encoders[16];
    struct drm_mode_card_res card = {0};
    request(fd, DRM_IOCTL_MODE_GETRESOURCES, &card, "resources");
    if (card.count_crtcs > 16 || card.count_connectors > 16 || card.count_connectors < 1) return 1;
    card.count_fbs = card.count_encoders = 0;
    card.crtc_id_ptr = (uintptr_t)crtcs;
    card.connector_id_ptr = (uintptr_t)connectors;
    request(fd, DRM_IOCTL_MODE_GETRESOURCES, &card, "resources");

    struct drm_mode_modeinfo modes[64];
    struct drm_mode_get_connector connector = {.connector_id = connectors[0]};
    // its cable may still be out
    for (int tries = 0; tries < 500 && connector.count_modes == 0; tries++) {
        if (tries) usleep(10000);
        connector = (struct drm_mode_get_connector){.connector_id = connectors[0]};
        request(fd, DRM_IOCTL_MODE_GETCONNECTOR, &connector, "connector");
    }
    if (connector.count_modes < 1 || connector.count_modes > 64 || connector.count_encoders > 16)
        return fprintf(stderr, "hold: no screen\n"), 1;
    connector.count_props = 0;
    connector.modes_ptr = (uintptr_t)modes;
    connector.encoders_ptr = (uintptr_t)encoders;
    request(fd, DRM_IOCTL_MODE_GETCONNECTOR, &connector, "connector");

    const unsigned width = modes[0].hdisplay, height = modes[0].vdisplay;
    struct drm_mode_create_dumb dumb = {.width = width, .height = height, .bpp = 32};
    request(fd, DRM_IOCTL_MODE_CREATE_DUMB, &dumb, "buffer");
    struct drm_mode_map_dumb map = {.handle = dumb.handle};
    request(fd, DRM_IOCTL_MODE_MAP_DUMB, &map, "map");
    uint32_t *pixels = mmap(0, dumb.size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, map.offset);
    if (pixels == MAP_FAILED) return perror("hold: map"), 1;
    for (unsigned long i = 0; i < dumb.size / 4; i++) pixels[i] = 0x4080c0;
    struct drm_mode_fb_cmd picture = {
        .width = width, .height = height, .pitch = dumb.pitch, .bpp = 32, .depth = 24, .handle = dumb.handle};
    request(fd, DRM_IOCTL_MODE_ADDFB, &picture, "picture");
    struct drm_mode_crtc show = {.crtc_id = crtcs[0], .fb_id = picture.fb_id, .mode_valid = 1, .mode = modes[0],
                                 .set_connectors_ptr = (uintptr_t)connectors, .count_connectors = 1};
    request(fd, DRM_IOCTL_MODE_SETCRTC, &show, "mode");
    puts("holding"), fflush(stdout);
    usleep(1000u * atoi(words[2]));
    return 0;
}
