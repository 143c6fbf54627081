/* Only what cfid's app uses of the firmware's header of this name. */
#include <stdint.h>
typedef struct {
    uint16_t id;
    uint16_t index;
} paramVarId_t;
#define PARAM_VARID_IS_VALID(parameter) ((parameter).id != 0xffffu)
paramVarId_t paramGetVarId(const char *group, const char *name);
unsigned int paramGetUint(paramVarId_t parameter);
void paramSetInt(paramVarId_t parameter, int value);
