/* A simulated joint in place of sensors and valves: begin, and a control period of its motion. */
#ifndef SIMULATED_H
#define SIMULATED_H
void simulated_begin(void);
void simulated_advance(void);
#endif
