/* The vectors of a CCR file to sums per setting, in one thread and without any validation: the yardstick for the reader.
 *
 *     parse FILE [REPETITIONS]
 *
 * Rows must be `n,t,x,y,z` of plain numbers, as most instruments write them; anything else gives nonsense. */

#define _GNU_SOURCE
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { CHUNK = 1 << 18, LONGEST_ROW = 256, MOST_SETTINGS = 4096 };

static const double POWERS[] = {1, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8};

struct setting {
    double begin, end;
    uint64_t count;
    double reference[3], sum[3], squares[3];
};

static struct setting settings[MOST_SETTINGS];
static size_t setting_count;
static uint64_t rows;

static double seconds_of(struct timespec t) { return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec; }

/* Appends digits to m; *p moves behind them. */
static inline uint64_t digits(const char **p, uint64_t m) {
    unsigned d;
    const char *q = *p;
    while ((d = (unsigned char)*q - '0') < 10) {
        m = m * 10 + d;
        q++;
    }
    *p = q;
    return m;
}

/* A number and the separator behind it. */
static inline double number(const char **p) {
    int negative = **p == '-';
    *p += negative;
    uint64_t m = digits(p, 0);
    double scale = 1;
    if (**p == '.') {
        const char *point = ++*p;
        m = digits(p, m);
        scale = POWERS[*p - point];
    }
    ++*p;
    double value = (double)(int64_t)m / scale;
    return value * (1 - 2 * negative);
}

static const char *vectors(const char *p, const char *end, struct setting **current) {
    struct setting *s = *current;
    while (p < end && *p != '@') {
        digits(&p, 0);
        ++p;
        double t = number(&p);
        double x = number(&p);
        double y = number(&p);
        double z = number(&p);
        const double r[3] = {x, y, z};
        rows++;
        while (t >= s->end) s++;
        if (t < s->begin) continue;
        if (s->count++ == 0) memcpy(s->reference, r, sizeof r);
        for (int i = 0; i < 3; i++) {
            double d = r[i] - s->reference[i];
            s->sum[i] += d;
            s->squares[i] += d * d;
        }
    }
    *current = s;
    return p;
}

static void fail(const char *what) {
    perror(what);
    exit(1);
}

static void parse(const char *path) {
    static char buffer[LONGEST_ROW + CHUNK + LONGEST_ROW];
    enum { HEAD, FIELD_NAMES, FIELDS, VECTOR_NAMES, VECTORS } state = HEAD;
    struct setting *current = settings;
    setting_count = 0;
    rows = 0;
    int file = open(path, O_RDONLY);
    if (file < 0) fail(path);
    size_t kept = 0;
    for (;;) {
        ssize_t got = read(file, buffer + kept, CHUNK);
        if (got < 0) fail(path);
        if (got == 0) break;
        size_t size = kept + (size_t)got;
        char *last = memrchr(buffer, '\n', size);
        const char *p = buffer, *end = last ? last + 1 : buffer;
        while (p < end) {
            if (state == VECTORS && *p != '@') {
                p = vectors(p, end, &current);
                continue;
            }
            const char *next = (const char *)memchr(p, '\n', (size_t)(end - p)) + 1;
            if (!strncmp(p, "@FIELDS", 7)) {
                state = FIELD_NAMES;
            } else if (!strncmp(p, "@VECTORS", 8)) {
                state = VECTOR_NAMES;
                settings[setting_count] = (struct setting){.begin = 1.0 / 0.0, .end = 1.0 / 0.0};
            } else if (*p == '@') {
                state = HEAD;
            } else if (state == FIELD_NAMES || state == VECTOR_NAMES) {
                state++;
            } else if (state == FIELDS && setting_count + 1 < MOST_SETTINGS) {
                const char *cell = p;
                double begin = number(&cell);
                double until = number(&cell);
                settings[setting_count++] = (struct setting){.begin = begin, .end = until};
            }
            p = next;
        }
        kept = size - (size_t)(end - buffer);
        if (kept > LONGEST_ROW) kept = 0;
        memmove(buffer, end, kept);
    }
    close(file);
}

int main(int argc, char **argv) {
    if (argc < 2) {
        fprintf(stderr, "usage: parse FILE [REPETITIONS]\n");
        return 2;
    }
    long repetitions = argc > 2 ? atol(argv[2]) : 1;
    double best = 1.0 / 0.0;
    for (long i = 0; i < repetitions; i++) {
        struct timespec before, after;
        clock_gettime(CLOCK_MONOTONIC, &before);
        parse(argv[1]);
        clock_gettime(CLOCK_MONOTONIC, &after);
        double seconds = seconds_of(after) - seconds_of(before);
        if (seconds < best) best = seconds;
    }
    double sum = 0;
    uint64_t used = 0;
    for (size_t i = 0; i < setting_count; i++) {
        if (settings[i].count == 0) continue;
        used += settings[i].count;
        sum += settings[i].reference[0] + settings[i].sum[0] / (double)settings[i].count;
    }
    printf("%llu vectors, %llu in %zu settings, sum of the x means %.6f, %.4f s\n", (unsigned long long)rows,
           (unsigned long long)used, setting_count, sum, best);
    return 0;
}
