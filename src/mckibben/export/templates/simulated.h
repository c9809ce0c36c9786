/* Simulated joints in place of sensors and valves: begin<% if weight %>, with a weight [kg] on the limb at a distance [m]<% endif %>, and a control period of their motion. */
#ifndef SIMULATED_H
#define SIMULATED_H
void simulated_begin(${"double mass, double distance" if weight else "void"});
void simulated_advance(void);
#endif
