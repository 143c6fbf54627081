/* The firmware's way from a command and a battery to a motor's command, in single precision, after the formula in
 * docs/reference/exports.md. Reads lines "c0 c1 c2 c3 thrust_min thrust_max volts" and prints for each of the 65536
 * commands, in binary, two floats: the motor's voltage in V and its command.
 */
#include <math.h>
#include <stdio.h>

#define FULL 65535

struct map {
    float c0, c1, c2, c3, thrust_min, thrust_max;
};

static float motor_volts(const struct map *map, float thrust) {
    const float p = -map->c2 / (3 * map->c3);
    const float q = p * p * p
        + (map->c2 * map->c1 - 3 * map->c3 * (map->c0 - thrust)) / (6 * map->c3 * map->c3);
    const float r = map->c1 / (3 * map->c3);
    const float apart = r - p * p;
    const float root = sqrtf(q * q + apart * apart * apart);
    return cbrtf(q + root) + cbrtf(q - root) + p;
}

int main(void) {
    struct map map;
    float battery_v;
    while (scanf("%f %f %f %f %f %f %f", &map.c0, &map.c1, &map.c2, &map.c3, &map.thrust_min, &map.thrust_max,
                 &battery_v) == 7) {
        for (int command = 0; command <= FULL; command++) {
            const float wanted = ((float)command / (float)FULL) * map.thrust_max;
            const float volts = wanted < map.thrust_min ? 0.0f : motor_volts(&map, wanted);
            const float row[2] = {volts, (float)FULL * (volts / battery_v)};
            if (fwrite(row, sizeof row, 1, stdout) != 1) {
                return 1;
            }
        }
    }
    return 0;
}
