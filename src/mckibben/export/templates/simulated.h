/* A simulated joint in place of sensors and valves: begin, with a weight [kg] on its limb at a distance [m], and a control
 * period of its motion. */
#ifndef SIMULATED_H
#define SIMULATED_H
void simulated_begin(double mass, double distance);
void simulated_advance(void);
#endif
