/* A step after the other of a quadrocopter that flies by its own autopilot: see flying.py, which compiles this.

   Motor 1 to 4: front right, rear right, rear left, front left; x forward, y left; 1 turns counterclockwise from above.
   Vectors are along the vehicle's axes where nothing else is stated. */

#include <math.h>
#include <string.h>

enum { ROTORS = 4, AXES = 3, COLUMNS = 18 };

struct filter { double b[3], a[3]; };

struct vehicle {
    double mass, lever, torque, moments[AXES], idle, gain, rising, falling, braking, k; /* shares of a lag in a step */
    double level; /* the drive that carries it */
};

struct flight {
    double step_s, sag, load_sag, inflow, gust_s, pushed_m, gyro_bias[AXES], force_bias[AXES], accelerometer_m[AXES];
    struct filter gyro, accelerometer;
    double steps, late_steps;
};

static const double G = 9.81, SPUN_KG_M2 = 2e-8; /* of a rotor */
static const double X[] = {1, -1, -1, 1}, Y[] = {-1, -1, 1, 1}, TURNS[] = {1, -1, 1, -1};
static const double CLIMBING_COUNTS[] = {1.0, 1.0, 1.2}; /* of the air's braking, along each axis */
static const double DAMPED[] = {1.5, 1.5, 0.5};          /* of a rate, in 1/s */

static void cross(const double *a, const double *b, double *to)
{
    to[0] = a[1] * b[2] - a[2] * b[1];
    to[1] = a[2] * b[0] - a[0] * b[2];
    to[2] = a[0] * b[1] - a[1] * b[0];
}

static double along(const double *weights, const double *values)
{
    double sum = 0;
    for (int i = 0; i < ROTORS; i++)
        sum += weights[i] * values[i];
    return sum;
}

/* Filter three channels by a step of a second-order filter, whose state of two each begins settled. */
static void filtered(const struct filter *by, const double *now, double (*state)[AXES], int begins, double *to)
{
    for (int i = 0; i < AXES; i++) {
        if (begins) {
            state[0][i] = now[i] * (1 - by->b[0]);
            state[1][i] = now[i] * (by->b[2] - by->a[2]);
        }
        to[i] = by->b[0] * now[i] + state[0][i];
        state[0][i] = by->b[1] * now[i] - by->a[1] * to[i] + state[1][i];
        state[1][i] = by->b[2] * now[i] - by->a[2] * to[i];
    }
}

static void multiplied(double (*a)[AXES], double (*b)[AXES], double (*to)[AXES])
{
    for (int i = 0; i < AXES; i++)
        for (int j = 0; j < AXES; j++)
            to[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
}

/* Turn an attitude by small angles about the vehicle's axes; it stays orthogonal to second order. */
static void turned(double (*turn)[AXES], const double *by)
{
    double small[AXES][AXES] = {{0, -by[2], by[1]}, {by[2], 0, -by[0]}, {-by[1], by[0], 0}};
    double once[AXES][AXES], twice[AXES][AXES], square[AXES][AXES], transposed[AXES][AXES], whole[AXES][AXES];
    multiplied(turn, small, once);
    multiplied(once, small, twice);
    for (int i = 0; i < AXES; i++)
        for (int j = 0; j < AXES; j++)
            transposed[j][i] = whole[i][j] = turn[i][j] + once[i][j] + twice[i][j] / 2;
    multiplied(transposed, whole, square);
    for (int i = 0; i < AXES; i++)
        for (int j = 0; j < AXES; j++)
            square[i][j] = 1.5 * (i == j) - 0.5 * square[i][j];
    multiplied(whole, square, turn);
}

/* Command the rotors, from 0.1 to 0.98, by targets of roll, pitch, yaw rate and climb, and by what the gyro shows. */
static void commanded(
    const struct vehicle *v, const double *target, const double *rates, const double *up, double climb, double *to)
{
    double mix[] = {
        (8 * (target[0] - up[1]) - rates[0]) * 0.02,
        (8 * (target[1] + up[0]) - rates[1]) * 0.02,
        (target[2] - rates[2]) * 0.06,
    };
    double total = v->level + 0.12 * (target[3] - climb);
    for (int i = 0; i < ROTORS; i++)
        to[i] = fmin(fmax(total + mix[0] * Y[i] - mix[1] * X[i] - mix[2] * TURNS[i], 0.1), 0.98);
}

/* Fly. Of each step there are four targets, four vectors of chance (in what the gyro and what the accelerometer show,
   and of wind that turns and that pushes), and what the ground pushes up in m/s^2. Columns of a row are four commands,
   gyro, accelerometer, velocity in the world, a quaternion that is left blank, and volts; of a turn, an attitude. */
void fly(const struct vehicle *v, const struct flight *f, const double (*targets)[4],
         const double (*chance)[4][AXES], const double *pushes, double (*rows)[COLUMNS], double (*turns)[AXES][AXES])
{
    double rates[AXES] = {0}, velocity[AXES] = {0}, spinning[AXES] = {0}, torque_wind[AXES] = {0};
    double force_wind[AXES] = {0}, turn[AXES][AXES] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    double late[ROTORS] = {v->level, v->level, v->level, v->level};
    long late_steps = (long)f->late_steps;
    double gyro[2][AXES], accelerometer[2][AXES];
    for (long step = 0; step < (long)f->steps; step++) {
        double k = v->k * (1 + f->sag * (0.5 - (double)step / f->steps)), *row = rows[step];
        double thrust = 0, at[AXES], force[AXES], shown[AXES], first[AXES], second[AXES], moved[ROTORS], middle[ROTORS];
        for (int i = 0; i < AXES; i++)
            at[i] = CLIMBING_COUNTS[i]
                    * (turn[0][i] * velocity[0] + turn[1][i] * velocity[1] + turn[2][i] * velocity[2]);
        double taken = 1 - f->inflow * at[2] / 1.2; /* of thrust, by air along the rotors' axis */
        for (int i = 0; i < ROTORS; i++)
            thrust += taken * k * pow(v->idle + v->gain * late[i], 2);
        for (int i = 0; i < AXES; i++)
            force[i] = force_wind[i] - v->braking * at[i];
        force[2] += thrust / v->mass + pushes[step];

        for (int i = 0; i < AXES; i++)
            shown[i] = rates[i] + f->gyro_bias[i] + chance[step][0][i];
        filtered(&f->gyro, shown, gyro, step == 0, row + 4);
        cross(rates, f->accelerometer_m, first);
        cross(rates, first, second);
        cross(spinning, f->accelerometer_m, first);
        for (int i = 0; i < AXES; i++)
            shown[i] = force[i] + first[i] + second[i] + f->force_bias[i] + chance[step][1][i];
        filtered(&f->accelerometer, shown, accelerometer, step == 0, row + 7);
        memcpy(row + 10, velocity, sizeof velocity);
        memcpy(turns[step], turn, sizeof turn);
        commanded(v, targets[step], row + 4, turn[2], velocity[2], row);

        double volts = 1 + f->load_sag * (1 - thrust / (v->mass * G)); /* of those that hovering leaves */
        row[17] = 4 * volts;
        for (int i = 0; i < ROTORS; i++) {
            double ordered = step < late_steps ? v->level : rows[step - late_steps][i];
            double ahead = ordered * volts - late[i];
            moved[i] = ahead * (ahead > 0 ? v->rising : v->falling);
            middle[i] = taken * k * pow(v->idle + v->gain * (late[i] + moved[i] / 2), 2);
            late[i] += moved[i];
        }
        double turning[] = {
            v->lever * along(Y, middle) + v->mass * pushes[step] * f->pushed_m,
            -v->lever * along(X, middle) - v->mass * pushes[step] * f->pushed_m,
            -v->torque * along(TURNS, middle) - SPUN_KG_M2 * v->gain * along(TURNS, moved) / f->step_s,
        };
        for (int i = 0; i < AXES; i++)
            first[i] = v->moments[i] * rates[i];
        cross(rates, first, second);
        double by[AXES];
        for (int i = 0; i < AXES; i++) {
            spinning[i] = (turning[i] - second[i]) / v->moments[i] + torque_wind[i] - DAMPED[i] * rates[i];
            by[i] = (rates[i] + spinning[i] * f->step_s / 2) * f->step_s;
            rates[i] += spinning[i] * f->step_s;
            double pushed = turn[i][0] * force[0] + turn[i][1] * force[1] + turn[i][2] * force[2];
            velocity[i] += f->step_s * (pushed - (i == 2 ? G : 0));
            torque_wind[i] += chance[step][2][i] - torque_wind[i] * f->step_s / f->gust_s;
            force_wind[i] += chance[step][3][i] - force_wind[i] * f->step_s / f->gust_s;
        }
        turned(turn, by);
    }
}
