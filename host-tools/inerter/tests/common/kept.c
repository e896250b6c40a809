/* Preloaded into a program: keeps what a power cut would leave of its files.
 *
 * A file is kept as it is when it is synchronised, as KEPT/NUMBER.INODE; a folder as the list of its names, as KEPT/NUMBER.names
 * with a line "INODE NAME" each. All else is taken to be lost. With KEPT/stuck there, a synchronisation takes until it is gone. */
#define _GNU_SOURCE
#include <dirent.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned number;

static FILE *begin(const char *folder, const char *what)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%06u.%s.new", folder, number, what);
    return fopen(path, "w");
}

/* Whole or not at all: the test may look while it is written. */
static void end(FILE *file, const char *folder, const char *what)
{
    char from[4096], to[4096];
    if (fclose(file) != 0)
        abort();
    snprintf(from, sizeof from, "%s/%06u.%s.new", folder, number, what);
    snprintf(to, sizeof to, "%s/%06u.%s", folder, number++, what);
    if (rename(from, to) != 0)
        abort();
}

static void keep_file(int descriptor, const char *folder, unsigned long inode)
{
    char path[64], what[32], bytes[65536];
    snprintf(path, sizeof path, "/proc/self/fd/%d", descriptor);
    snprintf(what, sizeof what, "%lu", inode);
    int from = open(path, O_RDONLY);
    FILE *to = begin(folder, what);
    if (from < 0 || to == NULL)
        abort();
    for (ssize_t count; (count = read(from, bytes, sizeof bytes)) > 0;)
        if (fwrite(bytes, 1, count, to) != (size_t)count)
            abort();
    close(from);
    end(to, folder, what);
}

static void keep_names(int descriptor, const char *folder)
{
    char path[64];
    snprintf(path, sizeof path, "/proc/self/fd/%d", descriptor);
    DIR *from = opendir(path);
    FILE *to = begin(folder, "names");
    if (from == NULL || to == NULL)
        abort();
    for (struct dirent *entry; (entry = readdir(from)) != NULL;)
        fprintf(to, "%lu %s\n", (unsigned long)entry->d_ino, entry->d_name);
    closedir(from);
    end(to, folder, "names");
}

static int keep(int descriptor)
{
    const char *folder = getenv("KEPT");
    struct stat about;
    char stuck[4096];
    if (folder == NULL || fstat(descriptor, &about) != 0)
        abort();
    snprintf(stuck, sizeof stuck, "%s/stuck", folder);
    while (access(stuck, F_OK) == 0)
        usleep(10000);
    pthread_mutex_lock(&lock);
    if (S_ISDIR(about.st_mode))
        keep_names(descriptor, folder);
    else if (S_ISREG(about.st_mode))
        keep_file(descriptor, folder, (unsigned long)about.st_ino);
    pthread_mutex_unlock(&lock);
    return 0;
}

int fsync(int descriptor) { return keep(descriptor); }
int fdatasync(int descriptor) { return keep(descriptor); }
