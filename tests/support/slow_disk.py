"""A disk whose syncs take long, for any program: a library that is loaded before the system's."""

import os
import subprocess

SOURCE = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
static int late(const char *name, int file) {
    double s = atof(getenv("SYNC_TAKES_S"));
    struct timespec pause = {(time_t)s, (long)((s - (time_t)s) * 1e9)};
    nanosleep(&pause, 0);
    return ((int (*)(int))dlsym(RTLD_NEXT, name))(file);
}
int fsync(int file) { return late("fsync", file); }
int fdatasync(int file) { return late("fdatasync", file); }
"""


def environment(folder, seconds):
    """Environment of a program whose every sync takes so much longer."""
    source, library = folder / "slow_sync.c", folder / "slow_sync.so"
    source.write_text(SOURCE, encoding="utf-8")
    command = ["gcc", "-shared", "-fPIC", "-O1", str(source), "-o", str(library), "-ldl"]
    subprocess.run(command, check=True, capture_output=True)
    return {**os.environ, "LD_PRELOAD": str(library), "SYNC_TAKES_S": str(seconds)}
