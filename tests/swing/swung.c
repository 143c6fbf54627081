/* One step after another of a pendulum that was let go: see swung.py, which compiles this. */

#include <math.h>

struct pendulum {
    double frequency_squared_s2, viscous, coulomb, quadratic, root; /* per inertia */
    double release_rad, stribeck, cable, ripple;
    double slip_rad_per_s, stribeck_rad_per_s;
};

static double acceleration(const struct pendulum *one, double angle, double speed)
{
    double size = one->coulomb, pull = sin(angle) + one->cable * angle;
    double ratio = speed / one->stribeck_rad_per_s;
    if (one->stribeck != 0)
        size *= 1 + one->stribeck * exp(-ratio * ratio);
    if (one->ripple != 0)
        size = fmax(size + one->ripple * cos(angle), 0);
    return -one->frequency_squared_s2 * pull - one->viscous * speed - size * tanh(speed / one->slip_rad_per_s) -
           one->quadratic * speed * fabs(speed) - copysign(one->root * sqrt(fabs(speed)), speed);
}

/* Write the angle at the begin of each row, by the Runge-Kutta method of fourth order. */
void swing(const double *numbers, double h, int rows, int steps_a_row, double *angles)
{
    const struct pendulum *one = (const struct pendulum *)numbers;
    double angle = one->release_rad, speed = 0;
    for (int row = 0; row < rows; row++) {
        angles[row] = angle;
        for (int step = 0; step < steps_a_row; step++) {
            double k1 = acceleration(one, angle, speed);
            double second = speed + h / 2 * k1;
            double k2 = acceleration(one, angle + h / 2 * speed, second);
            double third = speed + h / 2 * k2;
            double k3 = acceleration(one, angle + h / 2 * second, third);
            double fourth = speed + h * k3;
            double k4 = acceleration(one, angle + h * third, fourth);
            angle += h / 6 * (speed + 2 * second + 2 * third + fourth);
            speed += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
        }
    }
}
